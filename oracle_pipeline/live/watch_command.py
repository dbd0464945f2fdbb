"""``oracle watch`` and ``oracle recover``: watch a DDS domain, and finish what a watch left."""

import contextlib
import dataclasses
import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.live.quantities import as_keep, as_size, as_split
from oracle_pipeline.options import format_option, plugins_option

if TYPE_CHECKING:
    from oracle_pipeline.live.black_box import Keep
    from oracle_pipeline.live.events import Event
    from oracle_pipeline.live.page_server import LivePage
    from oracle_pipeline.live.source import Source
    from oracle_pipeline.live.split_bag import Split
    from oracle_pipeline.live.watch import Watch


_FILM = "import os; os.nice(19); from oracle_pipeline.cli import main; main()"
_PIECE_S = 120.0  # of each recording that a card is learned from


@click.command()
@click.option(
    "--reference", metavar="CARD", type=click.Path(path_type=Path, dir_okay=False),
    help="Reference card, from `oracle learn`. Without one, nothing is judged.")  # fmt: skip
@click.option(
    "--domain", type=click.IntRange(0, 232),
    help="DDS domain to watch.  [default: $ROS_DOMAIN_ID, else 0]")  # fmt: skip
@click.option(
    "--zenoh", metavar="ENDPOINT",
    help="Watch robots with rmw_zenoh behind this router, such as tcp/127.0.0.1:7447.")  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    help="Folder that the recording goes into. Without one, nothing is recorded.")  # fmt: skip
@click.option(
    "--learn", metavar="CARD", type=click.Path(path_type=Path, dir_okay=False),
    help="Learn a reference card at the end, from all recordings in --out: pieces of 2 minutes.  "
    "[default of --out: CARD.recordings]")  # fmt: skip
@click.option(
    "--split", metavar="SIZE|TIME", callback=as_split,
    help="Size or length of a file of the recording, such as 1GiB or 10min.  [default: one file]",
)  # fmt: skip
@click.option(
    "--keep-free", metavar="SIZE", callback=as_size,
    help="Free space at which recording ends.  [default: 2% of the disk, at most 1GiB]",
)  # fmt: skip
@click.option(
    "--keep", metavar="TIME+TIME", callback=as_keep,
    help="Keep only the time before and after alarms, such as 60s+30s.  [default: everything]",
)  # fmt: skip
@click.option(
    "--keep-on", metavar="TOPIC", multiple=True,
    help="A message on this topic is kept as an alarm is; so is the signal SIGUSR1.")  # fmt: skip
@click.option(
    "--keep-service", metavar="NAME", default="",
    help="Offer a std_srvs/srv/Trigger to robots with Cyclone DDS; a call is kept as an alarm is.",
)  # fmt: skip
@click.option(
    "--keep-at-most", metavar="SIZE", callback=as_size,
    help="Size of all that is kept; the oldest is deleted first.  [default: no limit]")  # fmt: skip
@click.option(
    "--alarms-per-hour", type=click.FloatRange(0.0, min_open=True),
    help="False alarms an hour that may be raised.  [default: 0.5, or what the card supports]",
)  # fmt: skip
@format_option("text", "json", text="Text for reading; one JSON object a line for programs.")
@click.option(
    "--duration", type=click.FloatRange(0.0, min_open=True),
    help="Seconds until it ends by itself.  [default: when Ctrl-C is pressed]")  # fmt: skip
@click.option(
    "--view", metavar="[PORT]", is_flag=False, flag_value=8300, type=click.IntRange(0, 65535),
    help="Serve a live page at 127.0.0.1.  [port: 8300; 0: any free one]")  # fmt: skip
@plugins_option
@click.pass_context
def watch(
    ctx: click.Context, reference: Path | None, domain: int | None, zenoh: str | None,
    out: Path | None, learn: Path | None, split: "Split", keep_free: int | None,
    keep: "Keep | None", keep_on: tuple[str, ...], keep_service: str, keep_at_most: int | None,
    alarms_per_hour: float | None, file_format: str, duration: float | None,
    view: int | None, plugins: Path | None,
) -> None:  # fmt: skip
    """Watch a running robot: record it, and judge it as it goes.

    It joins a DDS domain without ROS, takes the ROS graph every 10 s, and judges windows of 5 s as
    they end. It publishes nothing but the answers of --keep-service. However it ends, what was
    recorded until a second before is kept: `oracle score` judges it as a whole, and Foxglove opens
    its bag.

    Exit code 0: no alarm; 1: at least one; 2: it could not watch.

    \b
    Examples:
        oracle watch
        oracle watch --reference robot.card --out recordings/ --split 1GiB
        oracle watch --reference robot.card --view
        oracle watch --reference robot.card --out alarms/ --keep 60s+30s --keep-at-most 10GB
        oracle watch --learn robot.card --duration 3600
        oracle watch --reference robot.card --domain 7 --format json | jq .alarm
        oracle watch --zenoh tcp/192.168.1.20:7447 --out recordings/
    """  # noqa: D301 -- click reads the control character
    from oracle_pipeline.bags.dds_names import default_domain
    from oracle_pipeline.live import events
    from oracle_pipeline.live.watch import Watch

    if learn is not None:
        if reference is not None:
            raise click.UsageError("--learn and --reference exclude each other; give one of them.")
        out = out or learn.with_name(f"{learn.name}.recordings")
    if keep is not None:
        if out is None or learn is not None:
            raise click.UsageError("--keep needs --out, and no --learn.")
        keep = keep._replace(most_bytes=keep_at_most or math.inf, topics=frozenset(keep_on))
    if out is not None and out.is_dir():
        _finish_leftovers(out)
    number = default_domain() if domain is None else domain
    name = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    alarms, films = 0, []
    with contextlib.ExitStack() as stack:
        page = None if view is None else stack.enter_context(_page(view))
        watching = stack.enter_context(
            Watch(
                _source(number, zenoh, keep_service if keep else ""), card=reference, folder=out,
                name=name, split=split, piece_s=math.inf if learn is None else _PIECE_S, keep=keep,
                keep_free_bytes=keep_free, alarms_per_h=alarms_per_hour, plugins=plugins,
            )
        )  # fmt: skip
        for ends in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(ends, lambda *_: watching.stop())
        signal.signal(signal.SIGUSR1, lambda *_: watching.trigger("the signal SIGUSR1"))
        if duration is not None:
            signal.signal(signal.SIGALRM, lambda *_: watching.stop())
            signal.setitimer(signal.ITIMER_REAL, duration)
        click.echo(f"Watching domain {number}; Ctrl-C ends it.", err=True)
        for event in watching:
            alarms += isinstance(event, events.WindowAlarm | events.ContractAlarm)
            if page is not None:
                page.show(event)
            if isinstance(event, events.Note) and event.kept is not None:
                films.append(_begin_film(event.kept))
            for line in lines_of(event, watching, file_format):
                click.echo(line)
    dropped = watching.losses.lost.total()
    click.echo(f"{watching.received} messages received, {dropped} dropped.", err=True)
    if told := watching.losses.loss():
        click.echo(told, err=True)
    for path in watching.recordings:
        click.echo(f"Recording: {path}", err=True)
    if learn is not None and out is not None:
        _learn(ctx, learn, out)
    ctx.exit(1 if alarms else 0)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.pass_context
def recover(ctx: click.Context, folder: Path) -> None:
    """Finish recordings of `oracle watch` that were not completed.

    FOLDER is a recording, or the folder that was given with --out. A recording whose watch was
    killed is readable as it is; other tools need the end of its last file, which this writes.
    `oracle watch --out FOLDER` does the same when it starts.

    Exit code 0: all are complete; 2: one could not be finished.

    \b
    Examples:
        oracle recover recordings/
    """  # noqa: D301 -- click reads the control character
    ctx.exit(2 if _finish_leftovers(folder) else 0)


def _learn(ctx: click.Context, card: Path, out: Path) -> None:
    """Learn a card from the pieces in a folder; those that a session ended with are too short."""
    from oracle_pipeline.bags.run_directory import recording_summary

    summaries = {path: recording_summary(path) or {} for path in sorted(out.iterdir())}
    good = [p for p, told in summaries.items() if told.get("recording_s", 0.0) >= _PIECE_S / 2]
    if not good:
        raise OracleError(
            f"{out} has no recording of a minute; watch for longer, best for an hour."
        )
    group = ctx.find_root().command
    assert isinstance(group, click.Group)  # noqa: S101 -- `oracle`
    ctx.invoke(group.commands["learn"], good=good, output=card, roles=None, plugins=None)


def _finish_leftovers(folder: Path) -> int:
    """Finish recordings, and return how many could not be finished."""
    from oracle_pipeline.live.recovery import recover

    faults = 0
    for each in recover(folder):
        faults += bool(each.fault)
        told = each.fault or f"{each.messages} messages are kept."
        click.echo(f"{each.path} was not completed. {told}", err=True)
    return faults


def _source(domain: int, zenoh: str | None, service: str) -> "Source":
    """Join a domain on DDS, or behind a Zenoh router."""
    if zenoh is None:
        from oracle_pipeline.live.domain import Domain

        return Domain(domain, service=service)
    from oracle_pipeline.live.zenoh_source import ZenohRouter

    return ZenohRouter(zenoh, domain)


def _begin_film(recording: Path) -> "subprocess.Popen[bytes]":
    """Let another process draw a film when nothing else needs the processor.

    It goes on after the end of the watch. A robot without odometry has no film.
    """
    command: list[str | Path] = [sys.executable, "-c", _FILM, "replay", recording]
    none = subprocess.DEVNULL
    return subprocess.Popen(command, stdin=none, stdout=none, stderr=none, start_new_session=True)


def _page(port: int) -> "LivePage":
    """Return the live page, and print its address."""
    from oracle_pipeline.live.page_server import LivePage

    page = LivePage(port)
    click.echo(f"Page: {page.address}", err=True)
    return page


def lines_of(event: "Event", watching: "Watch", file_format: str) -> Iterator[str]:
    """Yield the lines of an event; a name with a newline cannot forge one."""
    lines = _as_json(event) if file_format == "json" else _as_text(event, watching)
    return (line.replace("\n", "\\n") for line in lines)


def _as_text(event: "Event", watching: "Watch") -> Iterator[str]:
    """Yield the lines of text of an event."""
    from oracle_pipeline.bags.terminal import aligned_lines, printable
    from oracle_pipeline.live import events
    from oracle_pipeline.scoring.output import HEADINGS, cells, first

    if isinstance(event, events.GraphTaken):
        kinds = [vertex.partition(":")[0] for vertex in event.graph]
        yield (
            f"{event.start_s:6d} s  graph: {kinds.count('node')} nodes, "
            f"{kinds.count('topic')} topics; {watching.received} messages so far"
        )
    elif isinstance(event, events.WindowVerdict) and not event.judged:
        yield f"{event.end_s:6.0f} s  not judged: the robot starts or leaves"
    elif isinstance(event, events.WindowVerdict):
        shown = "usual" if event.is_usual else "UNUSUAL"
        yield (
            f"{event.end_s:6.0f} s  {shown.ljust(7)} score {event.score:.3g}, "
            f"p = {event.p_value:.3g} among normal windows{event.robot and f' of {event.robot}'}"
            f"{'' if event.timed else ', without rate and timing: this machine is too busy'}"
        )
    elif isinstance(event, events.WindowAlarm):
        verdict = event.verdict
        of = verdict.robot and f" of {verdict.robot}"
        yield f"ALARM in the window from {verdict.start_s:g} s to {verdict.end_s:g} s{of}:"
        yield from aligned_lines([HEADINGS, *map(cells, verdict.evidence)], indent="    ")
    elif isinstance(event, events.ContractAlarm):
        yield f"ALARM at {event.at_s:.0f} s, against the contract of the normal recordings:"
        told = [printable(breach.text) for breach in event.breaches]
        yield from (f"    {line}" for line in first(told, "difference", ""))
    elif isinstance(event, events.Note):
        yield event.text


def _as_json(event: "Event") -> Iterator[str]:
    """Yield an event as an object with one key, its kind; messages are left out."""
    from oracle_pipeline.live import events

    document: dict[str, Any]
    if isinstance(event, events.GraphTaken):
        document = {"graph": {"start_s": event.start_s, "elements": len(event.graph)}}
    elif isinstance(event, events.WindowVerdict):
        document = {"window": dataclasses.asdict(event)}
    elif isinstance(event, events.WindowAlarm):
        document = {"alarm": dataclasses.asdict(event.verdict)}
    elif isinstance(event, events.ContractAlarm):
        breaches = [breach.text for breach in event.breaches]
        document = {"alarm": {"end_s": event.at_s, "contract": breaches}}
    elif isinstance(event, events.Note):
        document = {"note": event.text}
    else:
        return
    yield json.dumps(document, allow_nan=False)
