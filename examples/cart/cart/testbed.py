"""What the oracle has to know of the cart: its recipe, what a block draws, and how a run starts."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim.campaigns import Campaign
from sim.seeds import BLOCK, generator
from sim.testbed import Mode, Recipe, Testbed
from sim.testbed_run import TestbedRun


@dataclass(frozen=True, slots=True)
class CartRecipe(Recipe):
    """Everything that determines a run."""

    session: int
    mass_kg: float
    damping: float  # of the rail [N s/m]
    period_s: float  # of the target, which moves left and right
    duration_s: float


def draw(mode: Mode, run: int, campaign: Campaign, parameters: Mapping[str, Any]) -> CartRecipe:
    """Draw a run: all modes of a block have the same cart and the same task."""
    rng = generator(campaign.seed, BLOCK, run)
    return CartRecipe(
        **mode.recipe_fields(run, campaign, {}, parameters),
        session=campaign.session_of(run),
        mass_kg=float(rng.uniform(0.8, 1.2)),
        damping=float(rng.uniform(1.5, 2.5)),
        period_s=float(rng.uniform(8.0, 12.0)),
        duration_s=min(60.0, campaign.timeout_s),
    )


def bring_up(recipe: CartRecipe, folder: Path) -> TestbedRun:
    """Start a run; MuJoCo is imported only now."""
    from cart.run import CartRun

    return CartRun(recipe, folder)


CART = Testbed(
    scenarios=Path(__file__).with_name("scenarios"),
    experiments=("cart_normal", "cart_offset"),
    recipe=CartRecipe,
    draw=draw,
    bring_up=bring_up,
    made_by="cart.run",
)
