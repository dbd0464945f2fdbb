"""Hashes of 600 recorded runs: two revisions with equal hashes make the same bytes.

Every built-in scenario is recorded, on both testbeds, in worlds, sessions, storages and options
that take turns. A hash covers the messages and the graphs of a run. The first revision writes a
file of hashes; the second compares its own with it::

    python -m tools.bench.hashes before.json   # on one revision
    python -m tools.bench.hashes before.json   # on the other: prints the recipes that differ
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign, Options, RecipeError
from sim.experiments import recipe_for, record_run
from sim.modes import find_mode
from sim.scenarios import builtin_scenarios

RECIPES = 600
_ATC_S = 120.0  # of simulated time
OPTIONS = (
    Options(),
    Options(nav2="drawn"),
    Options(wiring="replace"),
    Options(relation="mirrored", hidden_topics=True),
    Options(odometry_source="encoder", receive_stamps=True),
    Options(arena="random", relation="reordered"),
    Options(arena="house", nav2="stock"),
)


class Job(NamedTuple):
    """One recipe to record."""

    scenario: str
    run: int
    campaign: Campaign


def jobs(count: int) -> list[Job]:
    """Return the recipes: scenarios and settings take turns."""
    scenarios = list(builtin_scenarios())
    return [_job(scenarios[index % len(scenarios)], index) for index in range(count)]


def _job(scenario: str, index: int) -> Job:
    campaign = Campaign(
        goals_per_run=1,
        storage="sqlite3" if index % 5 == 4 else "mcap",
        timeout_s=_ATC_S if scenario.startswith("atc") else Campaign().timeout_s,
        options=OPTIONS[index % len(OPTIONS)],
        noise_per_run=index % 3 == 2,
    )
    return Job(scenario, index, campaign)


def recorded(job: Job) -> str:
    """Record a run, and return the hash of its messages and graphs; or why there is no such run."""
    mode = find_mode(job.scenario, allow_actuation=True)
    try:
        recipe = recipe_for(mode, job.run, job.campaign)
    except RecipeError as error:  # a patrol that cannot be driven in reverse
        return str(error)
    with tempfile.TemporaryDirectory() as folder:
        run = RunDirectory(Path(folder), job.scenario, job.run)
        manifest = record_run(recipe, run)
        graphs = hashlib.sha256()
        for file in sorted(run.graphs.iterdir()):
            graphs.update(file.name.encode() + file.read_bytes())
    return f"{manifest.content_hash} {graphs.hexdigest()}"


def main() -> None:
    """Write the hashes, or compare them with those of another revision."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.hashes", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("file", type=Path, help="hashes; written if it does not exist")
    parser.add_argument("-n", type=int, default=RECIPES, help="recipes; default: %(default)s")
    arguments = parser.parse_args()
    todo = jobs(arguments.n)
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("fork")) as pool:
        hashes = pool.map(recorded, todo, chunksize=8)
        found = {f"{job.scenario} {job.run}": made for job, made in zip(todo, hashes, strict=True)}
    if not arguments.file.exists():
        arguments.file.write_text(json.dumps(found, indent=0, sort_keys=True))
        print(f"{len(found)} hashes written to {arguments.file}")
        return
    former = json.loads(arguments.file.read_text())
    common = found.keys() & former.keys()
    different = sorted(recipe for recipe in common if found[recipe] != former[recipe])
    print(f"{len(common) - len(different)} of {len(common)} recipes have the same bytes")
    for recipe in different:
        print(f"  differs: {recipe}")
    sys.exit(bool(different))


if __name__ == "__main__":
    main()
