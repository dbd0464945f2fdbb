"""Grids of mutants: one scenario at several magnitudes, over several blocks, and their index.

A mutant is a run directory. It is recorded in closed loop, or computed from the bag of a run of its
block in which the scenario's node forwarded everything. Then it shows what the topics would have
carried, but not how the robot would have reacted.
"""

import dataclasses
import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.integrity import hashes_of_files, require_undamaged
from oracle_pipeline.bags.layout import GRID_INDEX
from oracle_pipeline.bags.manifest import Manifest, Measured
from oracle_pipeline.bags.run_directory import (
    BAG_FOLDER,
    GRAPHS_FOLDER,
    MANIFEST_FILE,
    bytes_on_disk,
)
from sim.commands.parameter_values import Sweep
from sim.experiments import Job, recipe_for, recipe_of
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.offline import Summary, mutate_bag
from sim.software import software
from sim.testbed import Mode
from sim.testbeds import TESTBEDS, which_testbed


def mutants(mode: Mode, root: Path, sweeps: Sequence[Sweep], blocks: int) -> list[Job]:
    """Return a run for every value of every sweep in every block.

    Runs are numbered block by block, so a grid of more blocks begins with that of fewer.
    """
    points = [(sweep.parameter, value) for sweep in sweeps for value in sweep.values]
    return [
        Job(mode, root, block * len(points) + place, block, {parameter: value})
        for block in range(blocks)
        for place, (parameter, value) in enumerate(points)
    ]


def derive_mutant(controls: Path, refresh: bool, job: Job) -> Manifest:
    """Make a mutant from the run of its block below ``controls``.

    Raises
    ------
    RunDirectoryError
        If the place holds another mutant.
    OracleError
        If the run does not exist, lacks a topic of the scenario, or cannot be mutated.
    """
    mode = job.mode
    control = controls / f"run{job.block:03d}"
    original = Manifest.load(control / MANIFEST_FILE)
    require_undamaged(control, original)
    recipe = recipe_for(mode, original.block, recipe_of(original).campaign(), job.given)
    recipe = dataclasses.replace(recipe, run=job.run)
    document = {**recipe.to_dict(), "mutant_of": original.content_hash}
    directory = job.directory
    if directory.is_complete() and not refresh:
        found = directory.manifest()
        if found.recipe != document:
            raise RunDirectoryError(
                f"{directory.path} holds another mutant; simulate it again with "
                "--refresh, or choose another --out."
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
            goals_s=[result.accepted_s for result in original.goal_results],
        )
        shutil.copytree(control / GRAPHS_FOLDER, folder / GRAPHS_FOLDER)
        manifest = dataclasses.replace(
            _mutated(original, mode, summary),
            run=job.run,
            attack_seed=recipe.attack_seed(),
            attack={"frame": "odom", **recipe.parameters}
            if mode.scenario.has_object
            else dict(recipe.parameters),
            recipe=document,
            measured=Measured(
                time.perf_counter() - started, bytes_on_disk(folder), files=hashes_of_files(folder)
            ),
        )
        manifest.save(folder / MANIFEST_FILE)
    return manifest


def write_index(grid: Sequence[Job]) -> Path:
    """Write the index of the mutants that exist.

    Returns
    -------
    Path
        ``grid.json``: a list of records with ``run_id``, ``scenario``, ``parameter``, ``value``,
        ``block``, ``path`` (from the index), ``changed_messages`` and ``equivalent`` (nothing was
        changed).
    """
    rows = [_row(job) for job in grid if job.directory.is_complete()]
    path = grid[0].root / GRID_INDEX
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(rows, indent=1) + "\n", "utf-8")
    return path


def _row(mutant: Job) -> dict[str, Any]:
    directory = mutant.directory
    changed = sum(change.messages for change in directory.manifest().changes)
    ((parameter, value),) = mutant.given.items()
    return {
        "run_id": directory.key,
        "scenario": directory.mode,
        "parameter": parameter,
        "value": value,
        "block": mutant.block,
        "path": str(directory.path.relative_to(directory.root)),
        "changed_messages": changed,
        "equivalent": changed == 0,
    }


def _mutated(original: Manifest, mode: Mode, summary: Summary) -> Manifest:
    """Return the fields of a mutant's manifest that differ from those of its source run."""
    return dataclasses.replace(
        original, mode=mode.id, label=mode.label, scenario=mode.id,
        scenario_hash=mode.scenario.digest, onset_s=summary.onset_s, task_effect=None,
        changes=summary.changes, topics=summary.topics, content_hash=summary.content_hash,
        software=software(TESTBEDS[which_testbed(mode.scenario)]),
    )  # fmt: skip
