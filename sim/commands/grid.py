"""``oracle-sim grid``: the runs of a kill matrix."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from oracle_pipeline.bags.layout import grid_root
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.commands.batch import (
    allow_actuation_option,
    campaign,
    campaign_options,
    errors_told,
    home,
    make_runs,
    refresh_option,
    workers_option,
)
from sim.commands.kill_matrix import Mutant, derive_mutant, mutants, record_mutant, write_index
from sim.commands.parameter_values import sweep
from sim.modes import find_mode


@click.command("grid")
@click.argument("scenario", metavar="SCENARIO")
@click.option(
    "--over", "texts", required=True, multiple=True, metavar="NAME=LOW:HIGH:COUNT[:log]",
    help="A parameter and the values it takes, equal steps or (:log) equal ratios apart. Given "
    "more than once, each parameter is swept by itself.",
)  # fmt: skip
@click.option(
    "--blocks", default=5, show_default=True, type=click.IntRange(min=1),
    help="How many blocks; each has all values.",
)  # fmt: skip
@click.option(
    "--on", "controls", metavar="RUNS_DIR",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Mutate the bags of these runs (run000 is block 0) instead of recording: what the "
    "topics would have shown if the robot had driven the same way. Recording options have no "
    "effect then.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    help="Root of the run directories and place of grid.json.  [default: grids/SCENARIO below "
    "$ORACLE_HOME or ./data]",
)  # fmt: skip
@allow_actuation_option
@campaign_options
@workers_option
@refresh_option
def grid(
    scenario: str,
    texts: tuple[str, ...],
    blocks: int,
    controls: Path | None,
    out: Path | None,
    allow_actuation: bool,
    workers: int,
    refresh: bool,
    **options: Any,
) -> None:
    """Record a scenario at several strengths, to see which are detected.

    The result is a kill matrix, as in mutation testing: for each value of a parameter and each
    block, whether the oracle detects the altered run (kills the mutant). oracle_evaluation computes
    it, and the report shows it. Runs are recorded in closed loop, or with --on computed from
    recorded ones. grid.json has the value of each run and how many messages were changed; if none,
    the mutant is equivalent to the original.

    \b
    Examples:
        oracle-sim grid random_noise --over level=0.005:0.2:8:log --blocks 5
        oracle-sim grid random_noise --over level=0.005:0.2:8:log --on data/runs/lidar_passthrough
    """  # noqa: D301 -- click reads the control character
    with errors_told():
        mode = find_mode(scenario, allow_actuation=allow_actuation)
        made = mutants([sweep(mode, text) for text in texts], blocks)
    root = out or grid_root(home(), mode.id)
    make: Callable[[Mutant], Manifest]
    if controls is None:
        make = functools.partial(record_mutant, mode, campaign(options), root, refresh)
    else:
        make = functools.partial(derive_mutant, mode, controls, root, refresh)
    try:
        make_runs(make, made, lambda mutant: RunDirectory(root, mode.id, mutant.run), workers)
    finally:
        index = write_index(root, mode, made)
    click.echo(f"{index}: {len(made)} mutants")
