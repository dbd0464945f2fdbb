"""``oracle-sim record``: runs of one mode."""

import functools
from pathlib import Path
from typing import Any

import click

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from sim.commands.batch import (
    allow_actuation_option,
    campaign,
    campaign_options,
    home,
    make_runs,
    mode_option,
    refresh_option,
    workers_option,
)
from sim.experiments import recipe_for, record_run
from sim.fuzzing.scenario import ScenarioError
from sim.modes import broken_scenarios, find_mode
from sim.testbed import Mode


@click.command()
@mode_option()
@click.option(
    "--scenario", metavar="FILE",
    help="Your own experiment: a scenario file (FILE#NAME if it holds several), or a "
    "built-in scenario that is not a mode, by its name.",
)  # fmt: skip
@allow_actuation_option
@click.option(
    "-n", "--number", default=1, show_default=True, type=click.IntRange(min=1),
    help="How many runs: run000, run001, ...",
)  # fmt: skip
@click.option(
    "--first-block", default=0, show_default=True, type=click.IntRange(min=0),
    help="Block of the first run; run007 is of block 7.",
)  # fmt: skip
@click.option(
    "--session", type=click.IntRange(min=0),
    help="Session of all runs.  [default: as --sessions says]",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    default=home,
    help="Root of the run directories.  [default: $ORACLE_HOME or ./data]",
)  # fmt: skip
@campaign_options
@workers_option
@refresh_option
def record(
    mode: str | None,
    scenario: str | None,
    allow_actuation: bool,
    number: int,
    first_block: int,
    out: Path,
    workers: int,
    refresh: bool,
    **options: Any,
) -> None:
    """Record runs of one mode, or of a scenario.

    Run i of every mode has the same start, goals and session (block i), so runs compare across
    modes. Existing runs are kept, so the same call again completes an interrupted one.

    \b
    Examples:
        oracle-sim record -m fake_object -n 3 --out data
        oracle-sim record --scenario sensor_freeze
        oracle-sim record -m lidar_passthrough -n 14 --first-block 60 --sessions 2
        oracle features 'data/runs/fake_object/run000'
    """  # noqa: D301 -- click reads the control character
    for broken in broken_scenarios():
        click.echo(f"Left out: {broken}", err=True)
    experiment = _experiment(mode, scenario, allow_actuation=allow_actuation)
    job = functools.partial(_record, experiment, campaign(options), out, refresh)
    blocks = range(first_block, first_block + number)
    make_runs(job, blocks, functools.partial(RunDirectory, out, experiment.id), workers)


def _experiment(mode: str | None, scenario: str | None, *, allow_actuation: bool) -> Mode:
    if (mode is None) == (scenario is None):
        raise click.UsageError("Give either --mode or --scenario.")
    try:
        return find_mode(mode or scenario or "", allow_actuation=allow_actuation)
    except ScenarioError as error:
        raise click.BadParameter(str(error), param_hint="--scenario") from error


def _record(mode: Mode, settings: Campaign, out: Path, refresh: bool, run: int) -> Manifest:
    return record_run(
        recipe_for(mode, run, settings), RunDirectory(out, mode.id, run), refresh=refresh
    )
