"""``oracle``: the analysis from the command line, without Dagster.

Heavy imports are inside the commands, so that ``--help`` is fast.

Exit codes: 0 success, 2 failure for any reason. ``oracle score`` adds 1: anomalous;
``oracle compare`` adds 1: different.
"""

import json
import shlex
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.processes import collect_rarely
from oracle_pipeline.bags.terminal import PlainTextGroup, progress_bar, version_option
from oracle_pipeline.checks.check_command import check
from oracle_pipeline.comparison.compare_command import compare
from oracle_pipeline.live.watch_command import recover, watch
from oracle_pipeline.logs.import_command import import_logs
from oracle_pipeline.options import (
    RECORDING,
    detector_option,
    format_option,
    output_option,
    plugins_option,
    rate_option,
    recordings_argument,
)
from oracle_pipeline.replay.replay_command import replay
from oracle_pipeline.reporting.kinds_command import invariants, kinds, review
from oracle_pipeline.scoring.card_command import card

if TYPE_CHECKING:
    from oracle_pipeline.features import RecordingFeatures, Table
    from oracle_pipeline.robots.roles_file import RoleChoices
    from oracle_pipeline.scoring.verdict import Verdict

_SHOWN = "shown"  # value of an option given without a value


class _Failure(click.ClickException):
    """One line on stderr."""

    exit_code = 2


class _Group(PlainTextGroup):
    """Ends every failure with exit code 2. A bug prints its traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except (OracleError, OSError) as error:
            raise _Failure(str(error)) from error
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except Exception as error:
            traceback.print_exc()
            raise _Failure("This is a bug; please report it with the lines above.") from error


@click.group(cls=_Group)
@version_option
def main() -> None:
    """Tell normal from anomalous behaviour of a ROS 2 system, using only recordings.

    \b
    Examples:
        oracle learn good_bags/ --output robot.card
        oracle score tonight/* --reference robot.card --far 0.25
        oracle replay my_robot_bag/
    """  # noqa: D301 -- click reads the control character
    collect_rarely()


for command in (
    import_logs, card, check, replay, watch, recover, compare, kinds, review, invariants,
):  # fmt: skip
    main.add_command(command)


_strict = click.option(
    "--strict", is_flag=True,
    help="Reject recordings that are unfinished or have missing parts.")  # fmt: skip


_roles = click.option(
    "--roles", type=click.Path(path_type=Path, dir_okay=False, exists=True), metavar="FILE",
    help="YAML that names robots and roles of topics that cannot be detected.")  # fmt: skip


def _choices(roles: Path | None) -> "RoleChoices | None":
    """Return the content of a roles file."""
    from oracle_pipeline.robots.roles_file import RoleChoices

    return None if roles is None else RoleChoices.load(roles)


@main.command()
@recordings_argument
@click.option(
    "--table", type=click.Choice(["run", "window"]), default="run", show_default=True,
    help="One row for the recording, or one for each window of 5 s (every 2.5 s).")  # fmt: skip
@click.option(
    "--format", "file_format", type=click.Choice(["text", "json", "parquet"]),
    help="Text for reading; JSON for jq; Parquet for pandas, units in its schema.  [default: "
    "Parquet for FILE.parquet, text on a terminal, else JSON]")  # fmt: skip
@output_option("--output", "File to write; Parquet needs one.  [default: standard output]")
@click.option(
    "--roles", is_flag=False, flag_value=_SHOWN, metavar="[FILE]",
    help="Without FILE, after RUN_OR_BAG: print the roles of topics, and ambiguities. With FILE: "
    "YAML that names robots and roles of topics that cannot be detected.")  # fmt: skip
@plugins_option
@_strict
def features(
    recordings: tuple[Path, ...], table: str, file_format: str | None, output: Path | None,
    roles: str | None, plugins: Path | None, strict: bool,
) -> None:  # fmt: skip
    """Compute the features of recordings, a row for each.

    RUN_OR_BAG is a run directory, the folder of a rosbag2 (SQLite or MCAP, split or compressed), a
    single .mcap or .db3 file, a ROS 1 .bag file, another log, such as CSV, Parquet or PX4 ULog (see
    `oracle import --help`), or a folder of these. No ROS is needed. A feature that cannot be
    computed from this recording is null, and "missing" has the reason. An unfinished recording is
    read as far as possible; "notes" states how far, and which data were not used. Topics are found
    by message type, not by name. Several robots, each in a namespace, give one row each. A
    recording that cannot be read is left out, and the exit code is 2.

    \b
    Examples:
        oracle features data/runs/fake_object/run003
        oracle features my_robot_bag/ --format text | less
        oracle features my_robot_bag/ | jq '.rows[0]["contextual.total_turning"]'
        oracle features my_robot_bag/ --table window --output windows.parquet
        oracle features bags/* --output features.parquet
        oracle features my_robot_bag/ --roles
    """  # noqa: D301 -- click reads the control character
    if file_format is None and output is not None and output.suffix == ".parquet":
        file_format = "parquet"
    if file_format == "parquet" and output is None:
        raise click.UsageError("Parquet is a binary format: give a file with --output.")
    if roles == _SHOWN:
        for recording in recordings:
            _print_roles(recording, strict=strict)
        return
    from oracle_pipeline.datasets import write_table

    choices = _choices(Path(roles) if roles else None)
    tables, errors = _computed(recordings, plugins, choices, strict=strict)
    wanted = tables.run if table == "run" else tables.windows
    if output is not None and file_format == "parquet":
        write_table(wanted.frame(), output)
        for note in tables.notes:
            click.echo(note, err=True)
    else:
        for_reading = file_format == "text" or (
            file_format is None and output is None and sys.stdout.isatty()
        )
        text = _text(wanted, tables) if for_reading else _json(wanted, tables)
        if output is None:
            click.echo(text)
        else:
            output.write_text(text + "\n", encoding="utf-8")
    if errors:
        raise _Failure("\n".join(errors))


def _computed(
    recordings: Sequence[Path], plugins: Path | None, choices: "RoleChoices | None", *, strict: bool
) -> "tuple[RecordingFeatures, list[str]]":
    """Return the features of recordings, and what is wrong with those that cannot be read.

    Several are read at once, in processes of their own; their rows have paths as names.
    """
    work = partial(_features_of, plugins=plugins, choices=choices, strict=strict)
    if len(recordings) == 1:
        return work(recordings[0]), []
    from oracle_pipeline.features import together
    from oracle_pipeline.scoring.isolation import WIDE_LIMITS, isolated_each

    each = isolated_each([(work, path) for path in recordings], WIDE_LIMITS)
    found = list(progress_bar(each, unit="recording", total=len(recordings), desc="features"))
    errors = [str(one) for one in found if isinstance(one, OracleError)]
    measured = [
        one.among_others(path, number)
        for number, (path, one) in enumerate(zip(recordings, found, strict=True))
        if not isinstance(one, OracleError)
    ]
    if not measured:
        raise OracleError("\n".join(errors))
    return together(measured), errors


def _features_of(
    path: Path, plugins: Path | None, choices: "RoleChoices | None", *, strict: bool
) -> "RecordingFeatures":
    from oracle_pipeline import features

    return features.compute(path, features.build_manager(plugins), strict=strict, choices=choices)


def _print_roles(recording: Path, *, strict: bool) -> None:
    from oracle_pipeline.opened_run import open_run
    from oracle_pipeline.robots.robot import find_robots, roles_as_text

    with open_run(recording, strict=strict) as run:
        click.echo(roles_as_text(find_robots(run.bag)))


def _text(table: "Table", tables: "RecordingFeatures") -> str:
    """Return a feature table for reading, and the notes on it."""
    from oracle_pipeline.features.engine.table_text import as_text

    return as_text(table.frame(), tables.notes)


def _json(table: "Table", tables: "RecordingFeatures") -> str:
    """Return the rows of a feature table, with NaN as null, and the notes on them."""
    from oracle_pipeline.datasets import MISSING, WHERE

    rows = [
        {
            **{column: value if value == value else None for column, value in row.items()},
            **{column: json.loads(row[column]) for column in (WHERE, MISSING)},
        }
        for row in table.rows()
    ]
    document = {"rows": rows, "notes": tables.notes, "fields": table.fields}
    return json.dumps(document, indent=2, allow_nan=False)


@main.command()
@recordings_argument
@click.option(
    "--reference", required=True, type=click.Path(path_type=Path),
    help="Normal runs to compare with: a table of run features, a root with features/ or runs/, "
    "or any folder of run directories or bags. Attacked runs in it are left out.")  # fmt: skip
@rate_option("--far", "False positive rate: the share of normal runs that may be called anomalous.")
@format_option("text", "json", text="Text for reading; one JSON object for programs.")
@output_option("--junit", "File for the verdicts as JUnit XML, for a CI system.")
@output_option("--badge", "File for a badge (SVG) with outcome, lowest p-value and date.")
@output_option("--page", "File for a page (HTML) with the verdicts, their evidence and pictures.")
@click.option(
    "--time-limit", default=900.0, show_default=True, type=click.FloatRange(0.0, min_open=True),
    help="Time limit for the features of one recording [s].")  # fmt: skip
@click.option(
    "--memory-limit", default=4.0, show_default=True, type=click.FloatRange(0.0, min_open=True),
    help="Memory limit for the features of one recording [GiB].")  # fmt: skip
@click.option(
    "--contract", type=click.Path(path_type=Path, dir_okay=False, exists=True), metavar="FILE",
    help="Contract to use instead of the card's, as `oracle card show --contract` prints it.",
)  # fmt: skip
@click.option(
    "--no-contract", is_flag=True,
    help="Compare no topics, types, QoS, rates, fields, copies, repeats, parameters and no graph.",
)  # fmt: skip
@click.option(
    "--suite", is_flag=True,
    help="Hold --far for all recordings together: the share of normal ones among those called "
    "anomalous (Benjamini-Hochberg). Takes more normal runs.")  # fmt: skip
@click.option("-q", "--quiet", is_flag=True, help="Print one line for each recording not normal.")
@click.option("-v", "--verbose", is_flag=True, help="Print a line for each unusual family too.")
@detector_option
@_roles
@plugins_option
@_strict
@click.pass_context
def score(
    ctx: click.Context, recordings: tuple[Path, ...], reference: Path, far: float,
    file_format: str, junit: Path | None, badge: Path | None, page: Path | None,
    time_limit: float, memory_limit: float, contract: Path | None, no_contract: bool,
    suite: bool, quiet: bool, verbose: bool, detector: str,
    roles: Path | None, plugins: Path | None, strict: bool,
) -> None:  # fmt: skip
    """Judge recordings by comparison with normal ones.

    Exit code 0: all are normal; 1: at least one is anomalous or breaks the contract of the
    reference; 2: at least one could not be judged, or is of another kind of system.

    RUN_OR_BAG is as for `oracle features`, or a folder of these. Each recording is judged by
    itself, and each of its robots gets a verdict, such as bag#robot1. The p-value is the share of
    normal runs that score at least as high, each scored by a model that was not fitted on it. A
    recording is anomalous if its p-value is at most --far. A rate of 5% needs 19 normal runs of
    different days or starts, 1% needs 99. With fewer there is no verdict, only the score and the
    features outside their usual range.

    \b
    Examples:
        oracle score tonight/* --reference robot.card --far 0.1 --junit verdicts.xml
        oracle score tonight/* --reference robot.card --far 0.1 --page verdicts.html
        oracle score data/runs/fake_object/run003 --reference data/datasets/features.parquet
        oracle score my_robot_bag/ --reference data --format json \\
            | jq '.recordings[0].evidence[0]'
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.checks.run import fault_sentences
    from oracle_pipeline.datasets import replacing
    from oracle_pipeline.features import build_manager
    from oracle_pipeline.scoring import judging, output
    from oracle_pipeline.scoring.card import ReferenceCard
    from oracle_pipeline.scoring.contract_file import read_contract
    from oracle_pipeline.scoring.isolation import Limits
    from oracle_pipeline.scoring.junit import as_junit
    from oracle_pipeline.scoring.learning import card_source
    from oracle_pipeline.scoring.verdict import Verdict

    started = time.perf_counter()

    def write_junit(verdicts: "list[Verdict]") -> None:
        if junit is not None:
            with replacing(junit) as sink:
                sink.write(as_junit(verdicts))

    try:
        manager, choices = build_manager(plugins), _choices(roles)
        normal = card_source(reference, manager, choices, detector)
        if contract is not None:
            if not isinstance(normal, ReferenceCard):
                raise click.UsageError("--contract needs a card; write one with `oracle learn`.")
            normal = replace(normal, contract=read_contract(contract))
    except (OracleError, OSError) as error:
        write_junit([Verdict(str(path), "error", error=str(error)) for path in recordings])
        raise
    limits = Limits(time_limit, memory_limit)
    verdicts = judging.score(
        recordings, normal, manager, far, limits, strict=strict, choices=choices,
        hold_to_contract=not no_contract, together=suite, check=fault_sentences,
    )  # fmt: skip
    write_junit(verdicts)
    if file_format == "json":
        click.echo(output.as_json(verdicts, far, normal.notes))
    else:
        if quiet:
            text = output.in_brief(verdicts)
        else:
            text = output.as_text(verdicts, far, normal.notes, together=suite, verbose=verbose)
        click.echo(f"{text}{output.tally(verdicts)} in {time.perf_counter() - started:.1f} s")
    if badge is not None:
        from oracle_pipeline.reporting.badge import as_badge

        with replacing(badge) as sink:
            sink.write(as_badge(verdicts, datetime.now(UTC).date()))
    if page is not None:
        from oracle_pipeline.replay.picture import pictures
        from oracle_pipeline.reporting import verdict_page

        verdict_page.write(page, verdicts, far, (*normal.notes,), manager, limits, pictures)
        click.echo(f"Page: {page.resolve().as_uri()}", err=True)
    ctx.exit(output.exit_code(verdicts))


@main.command()
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False, exists=True), default=".",
    show_default=True, help="The only folder in which files are written.")  # fmt: skip
def mcp(folder: Path) -> None:
    """Serve the analysis to an assistant: learn, score and more.

    Speaks the Model Context Protocol over standard input and output. Needs the extra `mcp`.

    \b
    Examples:
        oracle mcp --folder ~/verdicts
    """  # noqa: D301 -- click reads the control character
    try:
        from oracle_pipeline.tool_server import build_server
    except ModuleNotFoundError as error:
        raise OracleError(
            f"{error}. Install the extra: pip install 'ros2-behaviour-oracle[mcp]'"
        ) from error
    build_server(folder).run()


@main.command()
@click.argument("good", metavar="GOOD...", nargs=-1, required=True, type=RECORDING)
@output_option("--output", "File to write, such as robot.card.", required=True)
@output_option("--contract", "File for the contract as YAML, to review and edit.")
@detector_option
@_roles
@plugins_option
def learn(
    good: tuple[Path, ...], output: Path, contract: Path | None, detector: str, roles: Path | None,
    plugins: Path | None,
) -> None:  # fmt: skip
    """Write a reference card from normal recordings.

    GOOD is a run directory, a bag, a folder of these, a table of run features, or a root with
    features/ or runs/. Attacked runs are left out. Use recordings of different days or starts: 19
    support a verdict at a false positive rate of 5%, 99 at 1%.

    \b
    Examples:
        oracle learn good_bags/ --output robot.card
        oracle learn data/datasets/features.parquet --output testbed.card
        oracle score tonight/* --reference robot.card
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.features import build_manager
    from oracle_pipeline.scoring.card import SUFFIX
    from oracle_pipeline.scoring.card_output import RATES, card_as_text, lowest_far
    from oracle_pipeline.scoring.contract_file import contract_as_yaml
    from oracle_pipeline.scoring.learning import learn as learn_card
    from oracle_pipeline.scoring.reference import read_reference

    if output.suffix != SUFFIX:
        raise click.UsageError(
            f"The name of the card must end with {SUFFIX}, such as {output}{SUFFIX}"
        )
    manager = build_manager(plugins)
    card = learn_card(read_reference(good, manager, _choices(roles)), detector)
    card.save(output)
    if contract is not None and card.contract is not None:
        contract.write_text(contract_as_yaml(card.contract), encoding="utf-8")
    click.echo(card_as_text(card))
    click.echo(f"Card: {output}")
    rate = lowest_far(card)
    far = f" --far {rate:g}" if rate > RATES[0] else ""
    click.echo(f"Next: oracle score RECORDING --reference {shlex.quote(str(output))}{far}")
