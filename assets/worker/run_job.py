"""What is requested for one run, and what a worker reports about it."""

from dataclasses import dataclass
from typing import Literal

from assets.worker.reproduction import Reproduction
from oracle_pipeline.bags.layout import TableName
from oracle_pipeline.bags.manifest import Kept
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign

RECORDED = ("experiment_runs", "bags", "interval_graphs")  # written by the simulation in one step
# Extracted from the recording in one step.
TABLES: dict[str, TableName] = {"window_features": "window", "run_features": "run"}
OF_A_RUN = frozenset({*RECORDED, *TABLES})  # every asset of a run

Figures = dict[str, int | float | str | bytes]  # bytes: a picture, PNG
Status = Literal["made", "remade", "verified"]


@dataclass(frozen=True, slots=True)
class RunJob:
    """The work that is requested for one run."""

    directory: RunDirectory
    campaign: Campaign
    wanted: frozenset[str]  # assets
    refresh: bool  # re-simulate a complete run
    keep: Kept = "full"  # how much of the bag to keep at the end

    def __str__(self) -> str:
        """Return the run's partition key."""
        return self.directory.key

    @property
    def wants_recording(self) -> bool:
        """Whether an asset is requested that the simulation writes."""
        return not self.wanted.isdisjoint(RECORDED)

    @property
    def wants_features(self) -> bool:
        """Whether an asset is requested that is extracted from the recording."""
        return not self.wanted.isdisjoint(TABLES)


@dataclass(frozen=True, slots=True)
class AssetOfRun:
    """The current state of one asset of one run."""

    path: str  # below the root
    code: str  # version of the code that produced it
    version: str  # hash of the content
    figures: Figures


@dataclass(frozen=True, slots=True)
class RunReport:
    """The result of the work on one run."""

    simulated_s: float  # simulated time; 0 if the run was complete
    assets: dict[str, AssetOfRun]  # those requested
    kept: Kept
    freed_bytes: int
    reproduction: Reproduction | None = None  # if it was complete and was re-simulated
