"""``oracle-sim record``: runs of some modes, or of a scenario."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import click

from sim.commands import batch
from sim.experiments import Job, record_job
from sim.fuzzing.scenario import ScenarioError
from sim.modes import find_mode, left_out
from sim.testbed import Mode
from sim.testbeds import TESTBEDS, require_testbed, which_testbed


@click.command()
@batch.mode_option()
@click.option(
    "--scenario", metavar="FILE",
    help="Your own experiment: a scenario file (FILE#NAME if it holds several), or a "
    "built-in scenario that is not a mode, by its name.")  # fmt: skip
@click.option(
    "--testbed", metavar="NAME",
    help=f"Where: {', '.join(TESTBEDS)}. Alone, it records normal runs; with --scenario, it runs "
    "that scenario there.  [default: that of the mode or scenario]")  # fmt: skip
@batch.allow_actuation_option
@batch.number_option
@click.option(
    "--first-block", default=0, show_default=True, type=click.IntRange(min=0),
    help="Block of the first run; run007 is of block 7.")  # fmt: skip
@click.option(
    "--session", type=click.IntRange(min=0),
    help="Session of all runs.  [default: as --sessions says]")  # fmt: skip
@batch.out_option
@batch.campaign_options
@batch.workers_option
@batch.refresh_option
def record(
    mode: tuple[str, ...], scenario: str | None, testbed: str | None, allow_actuation: bool,
    number: int, first_block: int, out: Path, workers: int, refresh: bool, **options: Any,
) -> None:  # fmt: skip
    """Record runs of some modes, of a scenario, or of a testbed.

    Run i of every mode has the same start, goals and session (block i), so runs compare across
    modes. Existing runs are kept, so the same call again completes an interrupted one.

    \b
    Examples:
        oracle-sim record -m lidar_passthrough_odom -m fake_object -n 3 --out data
        oracle-sim record --scenario sensor_freeze
        oracle-sim record --testbed atc -n 3
        oracle-sim record -m lidar_passthrough -n 14 --first-block 60 --sessions 2
        oracle features 'data/runs/fake_object/run000'
    """  # noqa: D301 -- click reads the control character
    for broken in left_out():
        click.echo(f"Left out: {broken}", err=True)
    chosen = functools.partial(_experiment, scenario, testbed, allow_actuation=allow_actuation)
    blocks = range(first_block, first_block + number)
    jobs = [Job(each, out, b, b) for each in map(chosen, mode or (None,)) for b in blocks]
    batch.make_runs(functools.partial(record_job, batch.campaign(options), refresh), jobs, workers)


def _experiment(
    scenario: str | None, testbed: str | None, mode: str | None, *, allow_actuation: bool
) -> Mode:
    if (mode is not None and scenario is not None) or not (mode or scenario or testbed):
        raise click.UsageError("Give either --mode or --scenario, or --testbed.")
    with batch.short_errors():
        name = mode or scenario or require_testbed(testbed or "").experiments[0]
    try:
        found = find_mode(name, allow_actuation=allow_actuation)
        its = which_testbed(found.scenario)
    except ScenarioError as error:
        raise click.BadParameter(str(error), param_hint="--scenario") from error
    if testbed in (None, its):
        return found
    if scenario is None:
        raise click.UsageError(f"{name} is a mode of testbed {its}, not of {testbed}.")
    with batch.short_errors():
        require_testbed(testbed)
    return dataclasses.replace(found, scenario=found.scenario.on(testbed))
