"""``oracle-sim grid``: the runs of a kill matrix."""

import functools
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from oracle_pipeline.bags.layout import grid_root
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import MANIFEST_FILE
from sim.commands import batch
from sim.commands.kill_matrix import derive_mutant, mutants, write_index
from sim.commands.parameter_values import BUILT_IN, sweep, sweeps_of
from sim.experiments import Job, record_job
from sim.modes import find_mode
from sim.scenarios import builtin_scenarios
from sim.testbed import Mode
from sim.testbeds import TESTBEDS, testbed_of, which_testbed


@click.command("grid")
@click.argument("scenario", metavar="[SCENARIO]", required=False)
@click.option(
    "--all", "all_attacks", is_flag=True,
    help="All built-in attacks that have a magnitude, each over its own range of it; with --on "
    "those on the testbed of these runs, with --allow-actuation also those that send commands.",
)  # fmt: skip
@click.option(
    "--over", "texts", multiple=True, metavar="NAME=LOW:HIGH:COUNT[:log]",
    help="A parameter and the values it takes, equal steps or (:log) equal ratios apart. Given "
    "more than once, each parameter is swept by itself.  [default: the magnitude of a built-in "
    "attack, or else each number with a min and a max in 8 steps]")  # fmt: skip
@click.option(
    "--blocks", default=5, show_default=True, type=click.IntRange(min=1),
    help="How many blocks; each has all values.")  # fmt: skip
@click.option(
    "--on", "controls", metavar="RUNS_DIR",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Mutate the bags of these runs (run000 is block 0) instead of recording: what the "
    "topics would have shown if the robot had driven the same way. Recording options have no "
    "effect then.")  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    help="Root of the run directories and place of grid.json; with --all, of a folder for each "
    "attack.  [default: grids/SCENARIO below $ORACLE_HOME or ./data]")  # fmt: skip
@batch.allow_actuation_option
@batch.campaign_options
@batch.workers_option
@batch.refresh_option
def grid(
    scenario: str | None, all_attacks: bool, texts: tuple[str, ...], blocks: int,
    controls: Path | None, out: Path | None, allow_actuation: bool, workers: int, refresh: bool,
    **options: Any,
) -> None:  # fmt: skip
    """Record a scenario at several strengths (a kill matrix).

    As in mutation testing, a kill matrix shows for each value of a parameter and each block whether
    the oracle detects the altered run (kills the mutant). oracle_evaluation computes it, and the
    report shows it. Runs are recorded in closed loop, or with --on computed from recorded ones.
    grid.json has the value of each run and how many messages were changed; if none, the mutant is
    equivalent to the original.

    \b
    Examples:
        oracle-sim grid random_noise --over level=0.005:0.2:8:log --blocks 5
        oracle-sim grid random_noise --over level=0.005:0.2:8:log --on data/runs/lidar_passthrough
        oracle-sim grid --all --on data/runs/lidar_passthrough_odom --blocks 20
    """  # noqa: D301 -- click reads the control character
    if (scenario is None) != all_attacks or (all_attacks and texts):
        raise click.UsageError("Name a SCENARIO, or give --all without --over.")
    with batch.short_errors():
        names = [scenario] if scenario else _attacks(controls, allow_actuation=allow_actuation)
        modes = [find_mode(name, allow_actuation=allow_actuation) for name in names]
        grids = [
            mutants(
                mode,
                _root(out, mode, all_attacks),
                [sweep(mode, text) for text in texts] or sweeps_of(mode),
                blocks,
            )
            for mode in modes
        ]
    make: Callable[[Job], Manifest]
    if controls is None:
        make = functools.partial(record_job, batch.campaign(options), refresh)
    else:
        make = functools.partial(derive_mutant, controls, refresh)
    jobs = list(itertools.chain(*grids))
    try:
        batch.make_runs(make, jobs, workers)
    finally:
        for grid in grids:
            click.echo(f"{write_index(grid)}: {len(grid)} mutants")


def _attacks(controls: Path | None, *, allow_actuation: bool) -> list[str]:
    """Return the built-in attacks that have a magnitude and may be run, or mutate these runs."""
    beds = list(TESTBEDS)
    if controls is not None:
        recipe = Manifest.load(controls / "run000" / MANIFEST_FILE).recipe
        beds = [testbed_of(recipe["scenario"])]
    return [
        name
        for name, scenario in builtin_scenarios().items()
        if BUILT_IN.get(name)
        and which_testbed(scenario) in beds
        and (allow_actuation or not scenario.may_move)
        and (controls is None or not scenario.needs_simulator)
    ]


def _root(out: Path | None, mode: Mode, is_one_of_many: bool) -> Path:
    if out is None:
        return grid_root(batch.home(), mode.id)
    return out / mode.id if is_one_of_many else out
