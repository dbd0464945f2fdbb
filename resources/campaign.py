"""Settings that all runs of the campaign share."""

from typing import Literal

import dagster as dg
from pydantic import Field

from sim.campaigns import DEFAULT_SEED, ArenaChoice, Campaign, Navigation, Options

# The defaults are those of the environment: a run config replaces all values of an instance.
_USUAL = Campaign.from_environment()


class CampaignSettings(dg.ConfigurableResource[None]):
    """Settings of the experiment runs; their defaults are those of the environment."""

    seed: int = Field(
        default=DEFAULT_SEED,
        ge=0,
        description="Seed of all randomness; the same seed gives the same messages.",
    )
    goals_per_run: int = Field(
        default=_USUAL.goals_per_run,
        ge=1,
        description="Goals of one run; 1 is the thesis's protocol.",
    )
    storage: Literal["mcap", "sqlite3"] = Field(
        default="mcap", description="Storage of the recorded bags."
    )
    arena: ArenaChoice = Field(
        default=_USUAL.options.arena,
        description="World of the runs; drawn: alternate hexagon, house and random arenas.",
    )
    nav2: Navigation = Field(
        default=_USUAL.options.nav2,
        description="Settings of Nav2: tuned to narrow gaps; stock, with which the collision "
        "monitor slows the robot down near walls; drawn: stock in houses, tuned elsewhere.",
    )
    sessions: int | None = Field(
        default=_USUAL.sessions,
        ge=1,
        description="Number of sessions to distribute blocks over; by default one per block.",
    )
    noise_per_run: bool = Field(
        default=_USUAL.noise_per_run,
        description="Draw sensor noise and latencies for each run instead of each block; an attack "
        "and its shadow control still share them.",
    )

    def campaign(self) -> Campaign:
        """Return the campaign that recipes are drawn from."""
        return Campaign(
            seed=self.seed,
            goals_per_run=self.goals_per_run,
            storage=self.storage,
            options=Options(arena=self.arena, nav2=self.nav2),
            sessions=self.sessions,
            noise_per_run=self.noise_per_run,
        )
