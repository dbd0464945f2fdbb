"""Compares a complete run with its re-simulation.

``assets.worker.run`` decides which of the two stays in use.
"""

from dataclasses import dataclass, replace

from oracle_pipeline.bags.layout import REFRESHED
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.experiments import RebuildResult, compared


@dataclass(frozen=True, slots=True)
class Reproduction:
    """The result of re-simulating a complete run."""

    comparison: RebuildResult
    former_hash: str  # of the messages
    new_hash: str


def refreshed_directory(run: RunDirectory) -> RunDirectory:
    """Return the directory of a re-simulated run that must not replace the previous one."""
    return replace(run, root=run.root / REFRESHED)


def judge(former: Manifest, again: RunDirectory) -> Reproduction:
    """Compare a run, by its manifest, with its re-simulation."""
    new = again.manifest()
    return Reproduction(compared(former, new), former.content_hash, new.content_hash)
