"""``oracle-sim fuzz``: runs of a scenario whose parameters are drawn."""

import functools
from pathlib import Path
from typing import Any

import click

from sim.commands.batch import (
    allow_actuation_option,
    campaign,
    campaign_options,
    make_runs,
    number_option,
    out_option,
    refresh_option,
    short_errors,
    workers_option,
)
from sim.commands.parameter_values import draw
from sim.experiments import Job, record_job
from sim.fuzzing.compilation import compile_scenario
from sim.modes import find_mode
from sim.seeds import node_generator

_PARAMETERS = 16  # branch of the seed on which parameters are drawn; recipes have those before


@click.command()
@click.option(
    "--scenario-template",
    "scenario",
    required=True,
    metavar="SCENARIO",
    help="NAME of a built-in scenario or mode, or FILE, or FILE#NAME if it holds several.",
)
@number_option
@out_option
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
        program = compile_scenario(mode.scenario, allow_actuation=allow_actuation)
        jobs = [
            Job(
                mode,
                out,
                run,
                run,
                draw(program, node_generator(options["seed"], _PARAMETERS, run, mode.id)),
            )
            for run in range(number)
        ]
    make_runs(functools.partial(record_job, campaign(options), refresh), jobs, workers)
