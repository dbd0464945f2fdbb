"""``oracle check``: faults of recordings that need no reference."""

from functools import partial
from pathlib import Path

import click

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.options import format_option, output_option, recordings_argument


@click.command()
@recordings_argument
@format_option("text", "json", text="Text for reading; one JSON object for programs.")
@output_option("--junit", "File for the faults as JUnit XML, with a test case for each recording.")
@output_option("--page", "File for a page (HTML) with the faults.")
@click.option("--strict", is_flag=True, help="Reject recordings that are unfinished.")
@click.pass_context
def check(
    ctx: click.Context, recordings: tuple[Path, ...], file_format: str, junit: Path | None,
    page: Path | None, strict: bool,
) -> None:  # fmt: skip
    """Find faults of recordings without a reference.

    Exit code 0: no fault; 1: at least one recording has a fault; 2: at least one could not be read.

    RUN_OR_BAG is as for `oracle features`. Every topic and every number in its messages is checked:
    silence of a steady topic (gap), messages that were held back (late burst), stamps that go back,
    measurements that stand still (stuck) or rest at their limit (saturation), places that jump,
    numbers beyond what their type allows (limit), NaN, quaternions that are no rotation, counters
    that go back or skip. Whether the behaviour was right takes normal recordings: see
    `oracle learn`.

    \b
    Examples:
        oracle check my_robot_bag/
        oracle check tonight/* --junit checks.xml --page checks.html
        oracle check flight.ulg --format json | jq '.recordings[0].faults'
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.bags.terminal import progress_bar
    from oracle_pipeline.checks import texts
    from oracle_pipeline.checks.run import check_recording
    from oracle_pipeline.datasets import replacing
    from oracle_pipeline.scoring.isolation import WIDE_LIMITS, isolated_each

    work = partial(check_recording, strict=strict)
    found = isolated_each([(work, path) for path in recordings], WIDE_LIMITS)
    bar = progress_bar(found, unit="recording", total=len(recordings), desc="check")
    results = [
        texts.Checked(str(path), error=str(faults))
        if isinstance(faults, OracleError)
        else texts.Checked(str(path), faults)
        for path, faults in zip(recordings, bar, strict=True)
    ]
    click.echo(texts.as_json(results) if file_format == "json" else texts.as_text(results))
    if junit is not None:
        with replacing(junit) as sink:
            sink.write(texts.as_junit(results))
    if page is not None:
        texts.write_page(page, results)
        click.echo(f"Page: {page.resolve().as_uri()}", err=True)
    ctx.exit(texts.exit_code(results))
