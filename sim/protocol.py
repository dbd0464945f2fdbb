"""How a run of any testbed becomes a run directory: made beside its place, then put into it."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RunDirectory
from sim.fuzzing.mutation import Program
from sim.fuzzing.program import compile_scenario
from sim.fuzzing.scenario import Scenario


class TestbedRun(Protocol):
    """A testbed that has come up, and the one run that is made in it."""

    def go(self) -> None:
        """Make the run; write bag and graphs."""

    def manifest(self, wall_s: float) -> Manifest:
        """Return what the finished run was."""


def make(
    directory: RunDirectory,
    bring_up: Callable[[Path], TestbedRun],
    former: Manifest | None = None,
) -> None:
    """Make a run, whole or not at all; it takes the place of one that is there.

    Parameters
    ----------
    directory
        Where it belongs.
    bring_up
        Brings the testbed up, to write into an existing and empty folder.
    former
        What this run was when it was made before: with the same software it is the same again.

    Raises
    ------
    OracleError
        If the run cannot be written, or is not what it was; its place is left as it was.
    """
    with directory.staged() as scratch:
        started = time.perf_counter()  # only for ``measured``: nothing that is recorded sees it
        run = bring_up(scratch)
        run.go()
        manifest = run.manifest(wall_s=time.perf_counter() - started)
        if former is not None:
            _require_same(former, manifest, directory)
        manifest.save(scratch / MANIFEST_FILE)


def _require_same(former: Manifest, manifest: Manifest, directory: RunDirectory) -> None:
    same_software = former.software == manifest.software
    if same_software and former.content_hash != manifest.content_hash:
        raise RunDirectoryError(
            f"{directory.path} was made again with the same software, and other messages came out. "
            "Either the manifest was edited or the machine computes wrongly; what was there is "
            f"kept. To have it made anew, remove {directory.path} and record the run again."
        )


def compiled(mode: str, document: Mapping[str, Any]) -> Program:
    """Compile the scenario in a recipe; whether it may move something was asked before.

    Raises
    ------
    ScenarioError
        If this release's language is no longer that of the recipe.
    """
    scenario = Scenario(f"recipe of {mode}", document, {(): 1})
    return compile_scenario(scenario, allow_actuation=True)
