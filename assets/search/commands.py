"""``oracle-sim search``: search for attacks that the oracle misses."""

from collections.abc import Iterator
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oracle_pipeline.options import rate_option
from sim.commands import batch

if TYPE_CHECKING:
    from assets.search.closed_loop import Finding


@click.command()
@click.argument("template", metavar="[TEMPLATE]", required=False)
@click.option(
    "--oracle", "--reference", "oracle", required=True,
    help="The oracle to search against: a reference card (`oracle learn`), a file of requirements "
    "or invariants (.yaml), or a kind of oracle, such as invariants or one of a plug-in.",
)  # fmt: skip
@click.option(
    "--normal", type=click.Path(path_type=Path, exists=True),
    help="Folder of normal recordings from which a kind of oracle learns, and its limit is set.  "
    "[default: a score above 0 is anomalous]")  # fmt: skip
@click.option(
    "--feedback", type=click.Choice(["sensors", "control", "belief"]),
    help="What guides the search: how far sensors disagree, commands are not followed, or odometry "
    "differs from the way driven.  [default: the effect on the task]")  # fmt: skip
@click.option(
    "--topic", "topics", multiple=True,
    help="Without TEMPLATE: a topic that may be altered in place; may be given more than once.",
)  # fmt: skip
@click.option(
    "--operator", "operators", multiple=True,
    help="With --topic: an operator to try, such as drift; may be given more than once.  "
    "[default: all]")  # fmt: skip
@click.option(
    "--budget", default="100", show_default=True,
    help="When to end: a number of trials in total, or a time such as 30m or 2h.")  # fmt: skip
@click.option(
    "--range", "ranges", metavar="NAME=LOW:HIGH", multiple=True,
    help="Bounds of a parameter of TEMPLATE. By default all numbers with a min and a max are "
    "varied.")  # fmt: skip
@click.option(
    "--blocks", default=3, show_default=True, type=click.IntRange(min=1),
    help="Number of blocks (start, goals, arena, session) that trials alternate over.")  # fmt: skip
@click.option(
    "--time-limit", default=120.0, show_default=True, type=click.FloatRange(min=1.0),
    help="Simulated seconds that a goal may take, on average.")  # fmt: skip
@rate_option("--far", "False positive rate at which the oracle decides.")
@click.option(
    "--sampler", default="tpe", show_default=True,
    type=click.Choice(["tpe", "guided", "random"]),
    help="How trials are proposed: by Optuna's TPE; by changing what has the largest impact, in "
    "good ones (guided); or at random, for comparison.",
)  # fmt: skip
@click.option(
    "--screen/--no-screen", default=True, show_default=True,
    help="Skip the run of a trial that the oracle detects in an altered recording.")  # fmt: skip
@click.option(
    "--out", default="search", show_default=True, type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the search. An existing search is continued.")  # fmt: skip
@click.option(
    "--corpus", type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the misses, as scenario files.  [default: misses in --out]")  # fmt: skip
@batch.allow_actuation_option
@batch.campaign_options
@batch.workers_option
def search(
    template: str | None, budget: str, out: Path, corpus: Path | None, workers: int, **options: Any
) -> None:
    """Search for attacks that the oracle misses.

    It looks for the largest effect on the robot's task at the smallest score. TEMPLATE is the name
    of a built-in scenario or mode, or FILE, or FILE#NAME; its parameters are varied. Without it,
    each trial chooses one of the given topics, an operator, its strength, its onset and its
    duration. Each trial is run in closed loop, compared with the same run without the attack, and
    scored. Later trials learn from both results.

    An effect of 1 is a change that matters: 15 % of path or time, 5 cm of clearance, a goal, a
    recovery, or 5 % of the commands. The search writes findings.json, front.png, and in misses/ a
    scenario file for each run with an effect that the oracle misses. Call it again with a larger
    budget to continue.

    \b
    Example:
        oracle learn data/datasets/features.parquet --output testbed.card
        oracle-sim search range_drift --oracle testbed.card --budget 30m --out drift
        oracle-sim search --topic /odom --topic /imu --wiring absent --oracle plain.card
        oracle-sim search range_drift --oracle my_robot.yaml --feedback belief
        ORACLE_SCENARIOS=drift/misses oracle-sim record -m range_drift_miss017
    """  # noqa: D301 -- click reads the control character
    from assets.search.outcome import MISSES, PICTURE, save
    from assets.search.search import CONTROLS, Search, SearchSettings, TrialBudget, attacks

    if (template is None) == (not options["topics"]):
        raise click.UsageError("Give either a TEMPLATE or --topic to vary.")
    with batch.short_errors():
        limit, of_runs = TrialBudget.parse(budget), batch.campaign(options)
        controls = out / CONTROLS
        names = {item.name for item in fields(SearchSettings)} - {"campaign"}
        settings = SearchSettings(campaign=of_runs, **{name: options[name] for name in names})
        space = attacks(template, controls, settings)
        click.echo(f"Varying {space.text}.")
        search = Search(out, space, settings, controls, of_runs.seed)
        _follow(search.run(limit, workers, partial(click.echo, err=True)))
        findings = search.findings
        where = corpus or out / MISSES
        files = save(out, findings, search.front, settings.far, where, of_runs.seed)
    click.echo(
        f"{len(findings)} trials, {sum(f.screened_out for f in findings)} of them detected before "
        f"they were run. {len(files)} had an effect and were missed."
    )
    for path in files:
        click.echo(f"Miss: {path}")
    click.echo(f"Picture: {out / PICTURE}")


def _follow(trials: "Iterator[Finding]") -> None:
    """Print each miss when it is found."""
    from oracle_pipeline.bags.terminal import progress_bar

    for finding in progress_bar(trials, unit="trial"):
        if finding.is_miss:
            values = ", ".join(
                f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                for key, value in finding.proposal.values.items()
            )
            click.echo(
                f"Miss: trial {finding.proposal.run} ({values}): effect {finding.effect:.2g}, "
                f"p = {finding.p_value:.2g}"
            )
