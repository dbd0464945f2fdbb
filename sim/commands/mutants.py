"""Grids of mutants: one scenario at several magnitudes, over several blocks, and their index.

A mutant is a run directory. It is recorded, or made from the bag of a run of its block in which
the scenario's node handed everything on: then it tells what the topics would have shown, not what
the robot would have done.
"""

import dataclasses
import json
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.integrity import hashes_of_files, require_undamaged
from oracle_pipeline.bags.manifest import Manifest, Measured
from oracle_pipeline.bags.run_directory import (
    BAG_FOLDER,
    GRAPHS_FOLDER,
    MANIFEST_FILE,
    RunDirectory,
    bytes_on_disk,
)
from sim.commands.parameter_grids import Sweep
from sim.experiments import record_run
from sim.fuzzing.offline import Summary, mutate_bag
from sim.fuzzing.program import compile_scenario
from sim.modes import Mode
from sim.recipes import Campaign, Options, recipe_for
from sim.software import software

INDEX_FILE = "grid.json"


@dataclass(frozen=True, slots=True)
class Cell:
    """One mutant of a grid."""

    run: int
    block: int
    parameter: str
    value: float

    @property
    def given(self) -> Mapping[str, float]:
        """The parameters that are not left to the block or the scenario."""
        return {self.parameter: self.value}


def grid(sweeps: Sequence[Sweep], blocks: int) -> list[Cell]:
    """Return every value of every sweep in every block.

    Runs are numbered block by block, so a grid of more blocks begins with that of fewer.
    """
    points = [(sweep.parameter, value) for sweep in sweeps for value in sweep.values]
    return [
        Cell(block * len(points) + place, block, *point)
        for block in range(blocks)
        for place, point in enumerate(points)
    ]


def record_mutant(
    mode: Mode, campaign: Campaign, root: Path, refresh: bool, cell: Cell
) -> Manifest:
    """Record a mutant in closed loop; raises as ``record_run`` does."""
    recipe = recipe_for(mode, cell.block, campaign, cell.given)
    return record_run(
        dataclasses.replace(recipe, run=cell.run),
        RunDirectory(root, mode.id, cell.run),
        refresh=refresh,
    )


def derive_mutant(mode: Mode, controls: Path, root: Path, refresh: bool, cell: Cell) -> Manifest:
    """Make a mutant from the run of its block below ``controls``.

    Raises
    ------
    RunDirectoryError
        If the place holds another mutant.
    OracleError
        If the run is not there, does not have what the scenario hears, or cannot be mutated.
    """
    control = controls / f"run{cell.block:03d}"
    original = Manifest.load(control / MANIFEST_FILE)
    require_undamaged(control, original)
    recipe = recipe_for(mode, original.block, _campaign(original), cell.given)
    recipe = dataclasses.replace(recipe, run=cell.run)
    document = {**recipe.to_dict(), "mutant_of": original.content_hash}
    directory = RunDirectory(root, mode.id, cell.run)
    if directory.is_complete() and not refresh:
        found = directory.manifest()
        if found.recipe != document:
            raise RunDirectoryError(
                f"{directory.path} is another mutant; refresh it, or choose another root."
            )
        return found
    program = compile_scenario(mode.scenario, allow_actuation=True)
    started = time.perf_counter()  # only for ``measured``
    with directory.staged() as folder:
        summary = mutate_bag(
            control / BAG_FOLDER,
            folder / BAG_FOLDER,
            program,
            recipe.attack_seed(),
            parameters=recipe.parameters,
        )
        shutil.copytree(control / GRAPHS_FOLDER, folder / GRAPHS_FOLDER)
        manifest = dataclasses.replace(
            _mutated(original, mode, summary),
            run=cell.run,
            attack={"frame": "odom", **recipe.parameters}
            if mode.has_object
            else dict(recipe.parameters),
            recipe=document,
            measured=Measured(
                time.perf_counter() - started, bytes_on_disk(folder), files=hashes_of_files(folder)
            ),
        )
        manifest.save(folder / MANIFEST_FILE)
    return manifest


def write_index(root: Path, mode: Mode, cells: Sequence[Cell]) -> Path:
    """Write which mutant is what, as far as they are there.

    Returns
    -------
    Path
        ``grid.json``: a list of records with ``run_id``, ``scenario``, ``parameter``, ``value``,
        ``block``, ``path`` (from the index), ``changed_messages`` and ``equivalent`` (nothing was
        changed).
    """
    rows = []
    for cell in cells:
        directory = RunDirectory(root, mode.id, cell.run)
        if directory.is_complete():
            changed = sum(change.messages for change in directory.manifest().changes)
            rows.append(_row(directory, cell, changed))
    root.mkdir(parents=True, exist_ok=True)
    path = root / INDEX_FILE
    path.write_text(json.dumps(rows, indent=1) + "\n", "utf-8")
    return path


def _row(directory: RunDirectory, cell: Cell, changed: int) -> dict[str, Any]:
    return {
        "run_id": directory.key,
        "scenario": directory.mode,
        "parameter": cell.parameter,
        "value": cell.value,
        "block": cell.block,
        "path": str(directory.path.relative_to(directory.root)),
        "changed_messages": changed,
        "equivalent": changed == 0,
    }


def _campaign(run: Manifest) -> Campaign:
    """Return the campaign that a run is of, as far as its block's draws depend on it."""
    return Campaign(
        seed=run.seed,
        goals_per_run=len(run.goals),
        timeout_s=run.recipe.get("duration_s", run.recipe.get("timeout_s")),
        storage=run.recipe["storage"],
        options=Options(**run.recipe.get("options", {})),
    )


def _mutated(original: Manifest, mode: Mode, summary: Summary) -> Manifest:
    """Return what the manifest of a mutant says otherwise than that of the run it is made of."""
    return dataclasses.replace(
        original,
        mode=mode.id,
        label=mode.label,
        scenario=mode.id,
        scenario_hash=mode.scenario.digest,
        onset_s=summary.onset_s,
        task_effect=None,
        changes=summary.changes,
        topics=summary.topics,
        content_hash=summary.content_hash,
        software=software(),
    )
