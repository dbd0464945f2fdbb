"""``oracle kinds``, ``oracle review`` and ``oracle invariants``: several kinds of oracle.

Heavy imports are inside the commands, so that ``--help`` stays fast.
"""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oracle_pipeline import options

if TYPE_CHECKING:
    from oracle_pipeline.oracles.kind import Material

_ANSWERS = click.Choice(["good", "bad", "?"])

_recordings = click.argument(
    "recordings", metavar="RUN_OR_BAG...", nargs=-1, required=True, type=options.RECORDING
)  # fmt: skip
_reference = click.option(
    "--reference", type=click.Path(path_type=Path, exists=True),
    help="Folder of normal recordings to learn from, besides those that are labelled normal.",
)  # fmt: skip
_requirements = click.option(
    "--requirements", type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="YAML file of formulas that every run should satisfy.  [default: those for stock Nav2]",
)  # fmt: skip


@click.command()
@_recordings
@_reference
@_requirements
@click.option(
    "--answers", type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="JSON file of a person's answers on some runs, as `oracle review` writes it.")  # fmt: skip
@click.option(
    "--questions", type=click.IntRange(0), default=0, show_default=True,
    help="Number of questions that labels answer in place of a person.")  # fmt: skip
@options.rate_option("--far", "False positive rate of each kind, and of all together.")
@options.format_option("text", "json", text="Text for reading; one JSON object for programs.")
@options.plugins_option
def kinds(
    recordings: tuple[Path, ...], reference: Path | None, requirements: Path | None,
    answers: Path | None, questions: int, far: float, file_format: str, plugins: Path | None,
) -> None:  # fmt: skip
    """Judge runs by several kinds of oracle, side by side.

    The kinds are implicit (crash, abort, silence), specified (formulas of signal temporal logic),
    invariants (learned from normal runs), differential (comparison with other runs of the same
    task), metamorphic (comparison with runs of a related task) and human (answers of a person).
    Each kind gives p-values at the same false positive rate, with whole sessions held out. `union`
    combines them at that rate. A root with datasets/ adds the scorer of a reference card.

    RUN_OR_BAG is a run directory, a bag, or a folder of these. Normal runs are found by their
    label; for bags without one, give a folder of normal ones with --reference.

    \b
    Examples:
        oracle kinds data
        oracle kinds data --questions 20 --format json
        oracle kinds tonight/ --reference good_bags/ --requirements my_robot.yaml
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.bags.terminal import progress_bar
    from oracle_pipeline.evaluation.kinds_comparison import by_cards, compare_kinds
    from oracle_pipeline.oracles import human
    from oracle_pipeline.oracles.registry import build_kinds
    from oracle_pipeline.reporting.kinds_tables import as_json, as_text

    given = human.load_answers(answers) if answers else {}
    material = _material(recordings, reference, requirements, given)
    if questions:
        material = human.answered_by_labels(material, questions)
    nothing: list[str] = []
    with progress_bar(nothing, unit="kind", desc="oracles") as bar:
        comparison = compare_kinds(
            build_kinds(material, plugins), material.runs, by_cards(recordings, material.runs),
            far, bar.set_postfix_str,
        )  # fmt: skip
    if file_format == "json":
        click.echo(as_json(comparison, far))
        return
    click.echo(as_text(comparison, far))
    click.echo(
        "Next: oracle replay RUN shows a run; oracle review asks you about those of which the "
        "kinds are least certain."
    )


@click.command()
@_recordings
@_reference
@_requirements
@options.output_option(
    "--answers", "JSON file of answers; runs that are in it already are skipped.",
    required=True,
)  # fmt: skip
@click.option(
    "-k", "count", type=click.IntRange(1), default=10, show_default=True,
    help="Number of runs to ask about.")  # fmt: skip
def review(
    recordings: tuple[Path, ...],
    reference: Path | None,
    requirements: Path | None,
    answers: Path,
    count: int,
) -> None:
    """Ask a person about the most informative runs.

    It selects the runs about which a model of the answers so far is least certain, and that differ
    most from those already answered. Inspect each with `oracle replay` or on its page of the
    report. Answers are saved after each question; `oracle kinds --answers` learns from them.

    \b
    Examples:
        oracle review data --answers answers.json -k 5
        oracle kinds data --answers answers.json
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.oracles import human

    given = human.load_answers(answers) if answers.is_file() else {}
    material = _material(recordings, reference, requirements, given)

    def ask(run: str) -> bool | None:
        click.echo(f"\n{run}")
        for line in human.evidence(material, run):
            click.echo(f"    {line}")
        question = "Was it good or bad? Type good, bad, or ? if you do not know"
        choice = click.prompt(question, type=_ANSWERS, default="?", show_choices=False)
        return None if choice == "?" else choice == human.BAD

    for run, bad in human.interview(material, ask, count):
        given[run] = bad
        human.save_answers(given, answers)
    click.echo(human.learned_line(replace(material, answers=given)))
    told = shlex.join(["oracle", "kinds", *map(str, recordings), "--answers", str(answers)])
    click.echo(f"Next: {told}")


@click.command()
@click.argument("good", metavar="GOOD...", nargs=-1, required=True, type=options.RECORDING)
@options.output_option("--output", "YAML file to write.", required=True)
def invariants(good: tuple[Path, ...], output: Path) -> None:
    """Learn invariants from normal recordings, one line each.

    The file has formulas of signal temporal logic: on the signals of `oracle kinds`, or on all
    numbers of a robot without odometry and commands. Review it, delete or change lines, and pass it
    to `oracle kinds --requirements`. Every second recording is kept for `oracle kinds`, which
    measures with recordings that the formulas were not learned from; fewer than 6 are all learned
    from.

    \b
    Examples:
        oracle invariants good_bags/ --output invariants.yaml
        oracle kinds tonight/ --reference good_bags/ --requirements invariants.yaml
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.datasets import replacing
    from oracle_pipeline.oracles.collecting import numbers_to_learn, traced_runs
    from oracle_pipeline.oracles.invariants import HEAD, Invariants, half_to_learn
    from oracle_pipeline.oracles.requirements import dump

    numbers = numbers_to_learn(good)
    runs = traced_runs([], good, numbers)
    normal = runs.where(runs.normal)
    seen = normal.where(half_to_learn(normal))
    learned = Invariants().learn(seen).requirements()
    with replacing(output) as sink:
        sink.write(dump(learned, HEAD, seen.digests(), numbers).encode())
    click.echo(
        f"{len(learned)} invariants of {len(seen.traces)} of {len(normal.traces)} recordings: "
        f"{output}"
    )
    click.echo(
        f"Next: review the file, then oracle kinds RECORDINGS --reference "
        f"{shlex.quote(str(good[0]))} --requirements {shlex.quote(str(output))}"
    )


def _material(
    recordings: tuple[Path, ...],
    reference: Path | None,
    requirements: Path | None,
    answers: dict[str, bool],
) -> "Material":
    from oracle_pipeline.oracles.collecting import numbers_to_learn, traced_runs
    from oracle_pipeline.oracles.kind import RELATION, SAME, KindError, Material
    from oracle_pipeline.oracles.requirements import NAV2, load

    wanted, normal = load(requirements or NAV2), [reference] if reference else []
    numbers = wanted.signals or numbers_to_learn([*normal, *recordings])
    found = traced_runs(recordings, normal, numbers)
    is_same = (found.table[RELATION] == SAME).to_numpy()
    if not is_same.any():
        raise KindError("All runs have a --relation; add the runs of the original tasks.")
    follow_ups = None if is_same.all() else found.where(~is_same)
    material = Material(found.where(is_same), wanted, answers, follow_ups)
    material, note = material.not_learned_from()
    if note:
        click.echo(note, err=True)
    return material
