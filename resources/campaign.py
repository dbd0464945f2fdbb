"""What all runs of the campaign have in common."""

from typing import Literal

import dagster as dg
from pydantic import Field

from sim.campaigns import DEFAULT_SEED, ArenaChoice, Campaign, Options


class CampaignSettings(dg.ConfigurableResource[None]):
    """Settings of the experiment runs; other values give other runs."""

    seed: int = Field(
        default=DEFAULT_SEED,
        ge=0,
        description="Seed of all randomness; the same seed gives the same messages.",
    )
    goals_per_run: int = Field(
        default=8, ge=1, description="Goals of the patrol of one run; 1 is the thesis's protocol."
    )
    storage: Literal["mcap", "sqlite3"] = Field(
        default="mcap", description="Storage of the recorded bags."
    )
    arena: ArenaChoice = Field(
        default="drawn",
        description="World of the runs; drawn: hexagon, house and random arenas take turns.",
    )

    def campaign(self) -> Campaign:
        """Return the campaign that recipes are drawn from."""
        return Campaign(
            seed=self.seed,
            goals_per_run=self.goals_per_run,
            storage=self.storage,
            options=Options(arena=self.arena),
        )
