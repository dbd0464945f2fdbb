"""Runs of any mode: recipes, and recording into a run directory, complete or not at all."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from oracle_pipeline.bags.errors import OracleError, RunDirectoryError
from oracle_pipeline.bags.integrity import require_undamaged
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.remote import is_local
from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RunDirectory, bytes_on_disk
from sim.campaigns import Campaign, RecipeError
from sim.modes import modes
from sim.pairs import judge_pair
from sim.software import software
from sim.testbed import Mode, Recipe, Testbed
from sim.testbeds import TESTBEDS, require_testbed, testbed_of, which_testbed

if TYPE_CHECKING:
    from sim.testbed_run import TestbedRun

RebuildResult = Literal[
    "same messages", "other software", "other recipe", "not deterministic", "unexplained"
]


@dataclass(frozen=True, slots=True)
class Job:
    """One run to make."""

    mode: Mode
    root: Path  # of the run directories
    run: int
    block: int
    given: Mapping[str, Any] = field(default_factory=dict)  # values of parameters, as `recipe_for`

    @property
    def directory(self) -> RunDirectory:
        """Run directory of the run."""
        return RunDirectory(self.root, self.mode.id, self.run)


def recipe_for(
    mode: str | Mode, run: int, campaign: Campaign, parameters: Mapping[str, Any] | None = None
) -> Recipe:
    """Return the recipe of one run of a campaign, on the testbed that its mode is for.

    Parameters
    ----------
    mode
        One of ``modes`` by its name, or any other mode.
    run, campaign
        Number of the run, and its campaign.
    parameters
        Values of the scenario's parameters, in place of those drawn for the block or the defaults.

    Raises
    ------
    OracleError
        If there is no such mode, or its testbed cannot draw such a run.
    """
    if isinstance(mode, str):
        if mode not in modes():
            raise RecipeError(f"There is no mode {mode!r}; there are {', '.join(modes())}.")
        mode = modes()[mode]
    return TESTBEDS[which_testbed(mode.scenario)].draw(mode, run, campaign, parameters or {})


def record_run(
    recipe: Recipe,
    directory: RunDirectory,
    *,
    refresh: bool = False,
    accompany: "Callable[[TestbedRun], object]" = lambda _: None,
) -> Manifest:
    """Make one run on the testbed of its recipe, completely or not at all.

    Parameters
    ----------
    recipe
        Recipe of the run.
    directory
        Place of the run; its mode and run are the recipe's.
    refresh
        Simulate an existing run again.
    accompany
        Called when the testbed has come up, before the run is made.

    Returns
    -------
    Manifest
        Of the new run, or of an existing complete run of the same recipe.

    Raises
    ------
    RunDirectoryError
        If the place holds a run of another recipe, or a damaged one.
    OracleError
        If the run cannot be written; its place is left as it was.
    """
    if directory.is_complete() and not refresh:
        return _verified(directory, recipe)
    return _make(recipe, directory, accompany=accompany)


def record_job(campaign: Campaign, refresh: bool, job: Job) -> Manifest:
    """Make the run of a job, as ``record_run`` does."""
    recipe = recipe_for(job.mode, job.block, campaign, job.given)
    return record_run(replace(recipe, run=job.run), job.directory, refresh=refresh)


def remake_run(former: Manifest, directory: RunDirectory) -> Manifest:
    """Rebuild a run whose bag was dropped or trimmed, from the recipe in its manifest.

    Parameters
    ----------
    former
        Manifest of the run.
    directory
        Place of the run, which is replaced.

    Returns
    -------
    Manifest
        Of the rebuilt run. With the same software, its messages are equal; with other software it
        is a new generation of the run, and its features must be computed again.

    Raises
    ------
    RunDirectoryError
        If the manifest holds no usable recipe, or the same software gives other messages.
    OracleError
        If the run cannot be written; its place is left as it was.
    """
    return _make(recipe_of(former), directory, former)


def recipe_of(manifest: Manifest) -> Recipe:
    """Return the recipe in a manifest.

    Raises
    ------
    RunDirectoryError
        If it is none: of another release, or of a run that was derived from another's bag.
    """
    try:
        return _made(manifest.recipe).recipe.from_dict(manifest.recipe)
    except (OracleError, KeyError, TypeError) as error:
        raise RunDirectoryError(
            f"Run {manifest.run} of {manifest.mode} cannot be simulated from its recipe: {error}. "
            "It was derived from another run's bag, or is of another release; repeat the command "
            "that made it."
        ) from error


def _made(recipe: Mapping[str, Any]) -> Testbed:
    """Return the testbed that a recipe is of."""
    return require_testbed(testbed_of(recipe["scenario"]))


def can_be_rebuilt(manifest: Manifest) -> bool:
    """Return whether this software gives the same run from the recipe in its manifest."""
    try:
        recipe_of(manifest)
    except RunDirectoryError:
        return False
    testbed = _made(manifest.recipe)
    return testbed.deterministic and manifest.software == software(testbed)


def compared(former: Manifest, again: Manifest) -> RebuildResult:
    """Return whether a rebuilt run equals the former one, and if not, why."""
    if again.content_hash == former.content_hash:
        return "same messages"
    if again.software != former.software:
        return "other software"
    if again.recipe != former.recipe:
        return "other recipe"
    return "unexplained" if _made(again.recipe).deterministic else "not deterministic"


def _make(
    recipe: Recipe,
    directory: RunDirectory,
    former: Manifest | None = None,
    accompany: "Callable[[TestbedRun], object]" = lambda _: None,
) -> Manifest:
    """Make a run, completely or not at all; it replaces an existing one."""
    testbed = require_testbed(testbed_of(recipe.scenario))
    with directory.staged() as scratch:
        started = time.perf_counter()  # only for ``measured``: nothing recorded depends on it
        run = testbed.bring_up(recipe, scratch)
        accompany(run)
        run.go()
        manifest = run.manifest(time.perf_counter() - started, software(testbed))
        if former is not None:
            _require_same(former, manifest, directory)
        manifest.save(scratch / MANIFEST_FILE)
    judge_pair(directory)
    return directory.manifest()


def _require_same(former: Manifest, manifest: Manifest, directory: RunDirectory) -> None:
    same_software = former.software == manifest.software
    if same_software and former.content_hash != manifest.content_hash:
        raise RunDirectoryError(
            f"{directory.path} was rebuilt with the same software, and its messages differ. "
            "Either the manifest was edited or the machine computes wrongly. The former run is "
            f"kept; to replace it, remove {directory.path} and record the run again."
        )


def _verified(directory: RunDirectory, recipe: Recipe) -> Manifest:
    """Return the manifest of a finished run, if it has this recipe and nothing is missing."""
    found = directory.manifest()
    ours = recipe.to_dict()
    if found.recipe != ours:
        names = {**ours, **found.recipe}
        other = [name for name in names if found.recipe.get(name) != ours.get(name)]
        raise RunDirectoryError(
            f"{directory.path} was made from another recipe (it differs in {', '.join(other)}); "
            "simulate it again with --refresh, or choose another root for this campaign."
        )
    sizes = bytes_on_disk(directory.path)
    if sizes != found.measured.bytes:
        raise RunDirectoryError(
            f"{directory.path} is damaged: its parts should have {dict(found.measured.bytes)} "
            f"bytes and have {sizes}; simulate it again with --refresh."
        )
    if is_local(directory.path):  # in an object store, files are compared when they are used
        require_undamaged(directory.path, found)
    return found
