"""``oracle-sim search``: look for attacks that the oracle misses."""

from pathlib import Path
from typing import Any

import click

from sim.campaigns import Campaign
from sim.commands.batch import (
    allow_actuation_option,
    campaign,
    campaign_options,
    errors_told,
    workers_option,
)


@click.command()
@click.argument("template", metavar="TEMPLATE")
@click.option(
    "--reference", "card", required=True,
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Reference card of the oracle to search against (`oracle learn`).",
)  # fmt: skip
@click.option(
    "--objective", default="evade", show_default=True,
    type=click.Choice(["evade", "break", "boundary"]),
    help="evade: the largest effect on the task at the smallest score. break: the largest effect. "
    "boundary: the smallest change of a message that is detected.",
)  # fmt: skip
@click.option(
    "--budget", default="100", show_default=True,
    help="When to end: 200 trials, earlier ones included; or 30m, or 2h.",
)  # fmt: skip
@click.option(
    "--range", "ranges", metavar="NAME=LOW:HIGH", multiple=True,
    help="Bounds of a parameter. By default all numbers with a min and a max are varied.",
)  # fmt: skip
@click.option(
    "--blocks", default=3, show_default=True, type=click.IntRange(min=1),
    help="Trials take turns in so many blocks: starts, goals, arenas and sessions.",
)  # fmt: skip
@click.option(
    "--far", default=0.05, show_default=True,
    type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
    help="False positive rate at which the oracle decides.",
)  # fmt: skip
@click.option(
    "--sampler", default="tpe", show_default=True, type=click.Choice(["tpe", "random"]),
    help="tpe learns from earlier trials; random does not, to compare with.",
)  # fmt: skip
@click.option(
    "--screen/--no-screen", default=True, show_default=True,
    help="For evade: give a trial up if the oracle detects it in an altered recording already.",
)  # fmt: skip
@click.option(
    "--out", default="search", show_default=True, type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the search. A search that is there goes on.",
)  # fmt: skip
@allow_actuation_option
@campaign_options
@workers_option
def search(
    template: str,
    card: Path,
    objective: str,
    budget: str,
    ranges: tuple[str, ...],
    blocks: int,
    far: float,
    sampler: Any,
    screen: bool,
    out: Path,
    allow_actuation: bool,
    workers: int,
    **options: Any,
) -> None:
    """Search a scenario's parameters for attacks that the oracle misses.

    TEMPLATE is the name of a built-in scenario or mode, or FILE, or FILE#NAME. Each trial proposes
    parameters, runs them in closed loop, compares what the robot did with the same run without the
    attack, and scores the recording. The next proposals learn from both.

    An effect of 1 is a change that matters: 15 % of the way or the time, 5 cm of clearance, a goal,
    a recovery, or 5 % of the commands. The search leaves findings.json, front.png, and in misses/ a
    scenario file for each run with an effect that the oracle passes. Call it again with a larger
    budget to go on.

    \b
    Example:
        oracle learn data/datasets/features.parquet --output testbed.card
        oracle-sim search range_drift --reference testbed.card --budget 30m --out drift
        ORACLE_SCENARIOS=drift/misses oracle-sim record -m range_drift_miss017
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.bags.terminal import progress_bar
    from resources.search.closed_loop import Setting
    from resources.search.objectives import OBJECTIVES
    from resources.search.outcome import PICTURE, misses, save
    from resources.search.space import search_space
    from resources.search.study import Budget, Search
    from sim.modes import find_mode

    with errors_told():
        mode = find_mode(template, allow_actuation=allow_actuation)
        chosen, limit = OBJECTIVES[objective], Budget.parse(budget)
        settings: Campaign = campaign(options)
        setting = Setting(mode, settings, card, far, screen and chosen.screens)
        space = search_space(mode, ranges)
        study = Search(
            out, setting, chosen, space, blocks=blocks, seed=settings.seed, sampler=sampler
        )
        varied = ", ".join(f"{d.name} {d.low:g} to {d.high:g}" for d in space)
        click.echo(f"Varies {varied}. Looks for {chosen.text}.")
        trials = study.run(limit, workers, lambda reason: click.echo(reason, err=True))
        for finding in progress_bar(trials, unit="trial", desc=mode.id):
            if finding.has_effect and finding.p_value > far:
                values = ", ".join(f"{k} {v:.4g}" for k, v in finding.proposal.given.items())
                click.echo(
                    f"Miss: trial {finding.proposal.run} ({values}): effect "
                    f"{finding.effect:.2g}, p = {finding.p_value:.2g}"
                )
        findings = study.findings
        files = save(out, mode.scenario, findings, study.front, far)
    click.echo(
        f"{len(findings)} trials, {sum(f.screened_out for f in findings)} of them detected before "
        f"they were run. {len(misses(findings, far))} had an effect and were passed."
    )
    for path in files:
        click.echo(f"Miss: {path}")
    click.echo(f"Picture: {out / PICTURE}")
