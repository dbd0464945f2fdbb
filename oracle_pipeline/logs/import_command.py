"""``oracle import``: write logs as rosbag2, or print the layout that is guessed."""

from pathlib import Path

import click

from oracle_pipeline.bags.terminal import aligned_lines


@click.command("import")
@click.argument("logs", metavar="LOG...", nargs=-1, required=True,
                type=click.Path(path_type=Path, exists=False))  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the bags; each has the name of its log.")  # fmt: skip
@click.option("--guess", is_flag=True, help="Print the layout of a CSV or Parquet log, and stop.")
def import_logs(logs: tuple[Path, ...], out: Path | None, guess: bool) -> None:
    """Write other logs as rosbag2, which Foxglove and `ros2 bag` open.

    LOG is a CSV or Parquet file, a folder of these (one topic each), a PX4 ULog (.ulg), an
    ArduPilot DataFlash log (.bin), a LeRobot data set or one of its episodes
    (DATASET/episode_000003), or an MCAP file with Protobuf or JSON. All other commands read these
    as they are, without an import.

    A table's columns of time and units, its topic and type are guessed. Correct the guess in
    oracle_log.yaml, beside the table or in the folder above it. ULog, DataFlash and MCAP need the
    extra `logs`.

    \b
    Examples:
        oracle import flight.ulg --out bags/
        oracle import --guess drive_01/ > oracle_log.yaml
        oracle import drive_*/ --out bags/
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.logs.formats import logs_at, read_log
    from oracle_pipeline.logs.recording import write_bag
    from oracle_pipeline.logs.tables import guess_layout

    if guess:
        click.echo(guess_layout(logs[0]).text(), nl=False)
        return
    if out is None:
        raise click.UsageError("Name the folder for the bags with --out.")
    for path in logs:
        for recording in logs_at(path) or [path]:
            log = read_log(recording)
            bag = out / recording.stem
            out.mkdir(parents=True, exist_ok=True)
            write_bag(log, bag)
            for note in log.notes:
                click.echo(f"{recording}: {note}", err=True)
            click.echo(f"{bag}:")
            rows = [
                (topic.name, topic.msgtype or "its own type", f"{len(topic.times_ns)} messages")
                for topic in log.topics
            ]
            click.echo("\n".join(aligned_lines(rows, indent="  ")))
