"""How a run of any testbed becomes a run directory: made beside its place, then put into it."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RunDirectory


class TestbedRun(Protocol):
    """A testbed that has come up, and the one run that is made in it."""

    def go(self) -> None:
        """Make the run; write bag and graphs."""

    def manifest(self, wall_s: float) -> Manifest:
        """Return what the finished run was."""


def make(directory: RunDirectory, bring_up: Callable[[Path], TestbedRun]) -> None:
    """Make a run, whole or not at all; it takes the place of one that is there.

    Parameters
    ----------
    directory
        Where it belongs.
    bring_up
        Brings the testbed up, to write into an existing and empty folder.

    Raises
    ------
    OracleError
        If the run cannot be written; its place is left as it was.
    """
    with directory.staged() as scratch:
        started = time.perf_counter()  # only for ``measured``: nothing that is recorded sees it
        run = bring_up(scratch)
        run.go()
        run.manifest(wall_s=time.perf_counter() - started).save(scratch / MANIFEST_FILE)
