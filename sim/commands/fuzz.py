"""``oracle-sim fuzz``: runs of a scenario whose parameters are drawn."""

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
    refresh_option,
    short_errors,
    workers_option,
)
from sim.commands.parameter_values import draw
from sim.experiments import recipe_for, record_run
from sim.modes import find_mode
from sim.seeds import node_generator
from sim.testbed import Mode

_PARAMETERS = 16  # branch of the seed on which parameters are drawn; recipes have those before


@click.command()
@click.option(
    "--scenario-template",
    "scenario",
    required=True,
    metavar="SCENARIO",
    help="NAME of a built-in scenario or mode, or FILE, or FILE#NAME if it holds several.",
)
@click.option(
    "-n", "--number", default=1, show_default=True, type=click.IntRange(min=1),
    help="How many runs: run000, run001, ...",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=home,
    help="Root of the run directories.  [default: $ORACLE_HOME or ./data]",
)  # fmt: skip
@allow_actuation_option
@campaign_options
@workers_option
@refresh_option
def fuzz(
    scenario: str,
    number: int,
    out: Path,
    allow_actuation: bool,
    workers: int,
    refresh: bool,
    **options: Any,
) -> None:
    """Record runs of a scenario with randomly drawn parameters.

    Every number with a min and a max is drawn uniformly between them; the values are in the
    run's manifest. Run i has start, goals and nuisance of block i. Existing runs are kept.

    \b
    Example:
        oracle-sim fuzz --scenario-template my_scenario.yaml -n 20 --seed 1
    """  # noqa: D301 -- click reads the control character
    with short_errors():
        mode = find_mode(scenario, allow_actuation=allow_actuation)
        draw(mode, node_generator(0, _PARAMETERS, 0, mode.id))  # fails if there is nothing to draw
    job = functools.partial(_record_drawn, mode, campaign(options), out, refresh)
    make_runs(job, range(number), functools.partial(RunDirectory, out, mode.id), workers)


def _record_drawn(mode: Mode, settings: Campaign, out: Path, refresh: bool, run: int) -> Manifest:
    drawn = draw(mode, node_generator(settings.seed, _PARAMETERS, run, mode.id))
    recipe = recipe_for(mode, run, settings, drawn)
    return record_run(recipe, RunDirectory(out, mode.id, run), refresh=refresh)
