"""Compares a complete run with its re-simulation.

``assets.worker.run`` decides which of the two stays in use.
"""

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from oracle_pipeline.bags.layout import REFRESHED
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.remote import is_local
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


@contextlib.contextmanager
def separate_directory(run: RunDirectory) -> Iterator[RunDirectory]:
    """Yield a local directory for a re-simulated run, separate from the previous one."""
    if is_local(run.root):
        yield refreshed_directory(run)
        return
    with tempfile.TemporaryDirectory(prefix="oracle-") as root:
        yield replace(run, root=Path(root))


def judge(former: Manifest, again: RunDirectory) -> Reproduction:
    """Compare a run, by its manifest, with its re-simulation."""
    new = again.manifest()
    return Reproduction(compared(former, new), former.content_hash, new.content_hash)
