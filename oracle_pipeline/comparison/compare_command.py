"""``oracle compare``: compares two sets of recordings.

Heavy imports are inside the command, so that ``--help`` stays fast.
"""

from pathlib import Path

import click

from oracle_pipeline.options import format_option, output_option, plugins_option, rate_option


@click.command()
@click.argument("first", metavar="A", type=click.Path(path_type=Path, exists=True))
@click.argument("second", metavar="B", type=click.Path(path_type=Path, exists=True))
@rate_option("--level", "Probability of reporting a difference between sets that do not differ.")
@format_option("text", "json", text="Text for reading; one JSON object for programs.")
@click.option("--markdown", is_flag=True, help="Print the comment for a pull request instead.")
@click.option(
    "--link", "links", multiple=True, metavar="URL",
    help="Link below that comment, such as to films; may be given more than once.")  # fmt: skip
@output_option(
    "--junit", "File for the outcome as JUnit XML, with a test case for each family of features."
)
@plugins_option
@click.pass_context
def compare(
    ctx: click.Context, first: Path, second: Path, level: float, file_format: str, markdown: bool,
    links: tuple[str, ...], junit: Path | None, plugins: Path | None,
) -> None:  # fmt: skip
    """Compare two sets of recordings, such as those of two builds.

    Exit code 0: no difference; 1: they differ; 2: they could not be compared.

    A and B are folders of run directories or bags, or tables of run features. Features, topics,
    QoS, nodes and edges are compared. If both sets have the same blocks of simulated runs (equal
    start and goals), each run is compared with its partner: 6 pairs can show a difference.
    Otherwise each set needs at least 4 recordings.

    \b
    Examples:
        oracle compare monday/ tuesday/
        oracle compare main/ pr/ --markdown > comment.md
        oracle compare old_build/ new_build/ --junit compare.xml
        oracle compare a/datasets/features.parquet b/datasets/features.parquet --level 0.01
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.comparison import texts
    from oracle_pipeline.comparison.set_comparison import compare as compare_sets
    from oracle_pipeline.comparison.set_comparison import read_sets
    from oracle_pipeline.datasets import replacing
    from oracle_pipeline.features import build_manager

    comparison = compare_sets(*read_sets(first, second, build_manager(plugins)), level)
    if markdown:
        click.echo(texts.as_markdown(comparison, links))
    else:
        click.echo((texts.as_json if file_format == "json" else texts.as_text)(comparison))
    if junit is not None:
        with replacing(junit) as sink:
            sink.write(texts.as_junit(comparison))
    ctx.exit(texts.EXIT_CODES[comparison.outcome])
