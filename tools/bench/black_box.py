"""Replay recorded runs to a watch with a black box: how much of attacks and of driving it keeps.

``python -m tools.bench.black_box CARD RUN... [CARD RUN...]`` plays runs to `Watch`, as a source of
messages in place of a domain, as fast as windows are judged. A card judges the runs after it, of
other blocks. An onset counts as kept if it is inside a recording that is left; bytes are those of
messages.

``python -m tools.bench.black_box --tables CAMPAIGN`` takes the windows of a campaign's tables
instead, so it needs minutes for hours of driving: each half of the blocks is judged by a card of
the other half's normal runs, without a contract, and seconds stand for bytes.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pandas as pd
from rosbags.interfaces import QosDurability, QosReliability

from oracle_pipeline.bags.discovery import ENTITIES_QOS, Discovery, Endpoint
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.protocol import INTERVAL_S
from oracle_pipeline.bags.run_directory import MANIFEST_FILE
from oracle_pipeline.datasets import WINDOW_START, read_table
from oracle_pipeline.evaluation.estimate import clopper_pearson
from oracle_pipeline.features import build_manager
from oracle_pipeline.live.black_box import BlackBox, Keep
from oracle_pipeline.live.events import WindowVerdict
from oracle_pipeline.live.intake import Intake, Received
from oracle_pipeline.live.recorder import Recorder
from oracle_pipeline.live.source import Source
from oracle_pipeline.live.watch import Watch
from oracle_pipeline.opened_run import OpenedRun, open_run
from oracle_pipeline.scoring.alarms import RATE_PER_H, AlarmWatch
from oracle_pipeline.scoring.learning import learn
from oracle_pipeline.scoring.reference import Reference, read_reference
from oracle_pipeline.windows import HOP_S, WINDOW_S

KEEP = Keep(60.0, 30.0)
_AHEAD_S = HOP_S + 1.0  # of the newest verdict, at most: a second arrives at once
_WAIT_S = 0.002
_STEADY_NS = 10**18  # of the steady clock when a recording begins: later than the machine's
_SECOND_NS = 10**9
_TAKES_ALL = ENTITIES_QOS._replace(
    reliability=QosReliability.BEST_EFFORT, durability=QosDurability.VOLATILE
)


class RecordedSystem(Discovery):
    """The nodes and topics of a run, as of one of its intervals."""

    def __init__(self) -> None:
        super().__init__()
        self._handles: dict[tuple[str, str, int], int] = {}  # of the edges of the graph
        self._nodes: dict[str, frozenset[bytes]] = {}
        self._left: dict[str, dict[int, float]] = {}  # messages still to send, by topic and writer

    def go_to(self, run: OpenedRun, second: int) -> None:
        """Let a time of a run be now."""
        if second % INTERVAL_S:
            return
        self.endpoints, self._left = {}, {}
        nodes: dict[str, set[bytes]] = {}
        graph = run.intervals[min(int(second // INTERVAL_S), len(run.intervals) - 1)].graph
        for begin, end, traffic in graph.edges(data=True):
            publishes = graph.nodes[begin]["kind"] == "node"
            node, topic = (begin, end) if publishes else (end, begin)
            name, msgtype = graph.nodes[topic]["label"], graph.nodes[topic]["type"]
            known = run.bag.topics.get(name)
            profiles = known.qos if known is not None and publishes else (_TAKES_ALL,)
            left = self._left.setdefault(name, {})
            sent = sum(each["messages"] for _, _, each in graph.in_edges(topic, data=True))
            # A node that has several subscriptions gets each message several times.
            copies = 1 if publishes else max(1, round(traffic["messages"] / max(1, sent)))
            for copy in range(copies):
                handle = self._handles.setdefault((begin, end, copy), len(self._handles))
                guid, qos = handle.to_bytes(16, "big"), profiles[len(left) % len(profiles)]
                nodes.setdefault(graph.nodes[node]["label"], set()).add(guid)
                self.endpoints[handle] = Endpoint(guid, handle, b"", name, msgtype, qos, publishes)
            if publishes:
                left[handle] = traffic["messages"]
        self._nodes = {name: frozenset(of) for name, of in nodes.items()}

    def writer(self, topic: str) -> int:
        """Return who sends the next message of a topic: the one with most left to send."""
        left = self._left.get(topic) or {-1: 0.0}  # none is known
        writer = max(left, key=left.__getitem__)
        left[writer] -= 1
        return writer

    def update(self) -> bool:
        """Return that something may have changed."""
        return True

    def nodes(self) -> Iterable[Mapping[str, frozenset[bytes]]]:
        """Return the nodes of the only participant."""
        return [self._nodes]


class Played(Source):
    """Runs that are played, a second at a time, as fast as windows are judged.

    Attributes
    ----------
    stop : callable
        Ends the watch, once all was played.
    sent : int
        Bytes of the messages so far.
    """

    stop: Callable[[], None]

    def __init__(self, runs: Sequence[Path]) -> None:
        self._system = RecordedSystem()
        super().__init__({}, self._system, Intake())
        self.sent = 0
        self._now_s, self._judged_s, self._passed_ns = 0.0, 0.0, _STEADY_NS
        with open_run(runs[0]) as first:
            self._system.go_to(first, 0)
        self._rest = (second for run in runs for second in self.seconds(run))

    def judged(self, verdict: WindowVerdict) -> None:
        """Take note of a verdict; one from the run before does not count."""
        if verdict.end_s <= self._now_s:
            self._judged_s = verdict.end_s

    def pause(self) -> bool:
        """Let the next second come, unless a verdict is still to come; it is never too late."""
        if not self.intake.topics or self._now_s > self._judged_s + _AHEAD_S:
            time.sleep(_WAIT_S)
        elif (came := next(self._rest, None)) is not None:
            self.intake.put(came)
        else:
            self.stop()
        return False

    def close(self) -> None:
        """Do nothing: nothing is open."""

    def seconds(self, path: Path) -> Iterator[list[Received]]:
        """Yield the messages of each second of a run."""
        self._judged_s = WINDOW_S - HOP_S
        with open_run(path) as run:
            start_ns = run.bag.start_ns
            later_ns, writer = self._passed_ns - start_ns, self._system.writer
            for second, messages in groupby(
                run.bag.messages(), lambda message: (message.stamp_ns - start_ns) // _SECOND_NS
            ):
                self._system.go_to(run, second)
                self._now_s = second + 1.0
                came = [
                    Received(topic, at_ns, at_ns, later_ns + at_ns, writer(topic), data)
                    for topic, at_ns, data in messages
                    if topic in self.intake.topics
                ]
                self.sent += sum(len(each.data) for each in came)
                yield came
            self._passed_ns += run.bag.end_ns - start_ns + _SECOND_NS


class Outcome(NamedTuple):
    """What a black box did with a run."""

    hours: float
    sent: float  # [B], or [s] from tables
    kept: float
    inside: bool | None  # whether the onset is in a kept recording; None: there is no attack


def outcome(path: Path, card: Path) -> Outcome:
    """Play a run to a watch, and return what became of it."""
    source, manifest = Played([path]), Manifest.load(path / MANIFEST_FILE)
    kept, inside = 0, False
    with tempfile.TemporaryDirectory() as folder:
        with Watch(source, card=card, folder=Path(folder), keep=KEEP) as watch:
            source.stop = watch.stop
            for event in watch:
                if isinstance(event, WindowVerdict):
                    source.judged(event)
        with open_run(path) as run:
            onset_ns = run.bag.start_ns + round((manifest.onset_s or 0.0) * _SECOND_NS)
        for recording in watch.recordings:
            with open_run(recording) as run:
                kept += sum(len(message.data) for message in run.bag.messages())
                begin_ns = run.bag.start_ns - _SECOND_NS  # a second arrives at once
                inside |= begin_ns <= onset_ns <= run.bag.end_ns
    is_attack = manifest.label == "malicious" and manifest.onset_s is not None
    return Outcome(manifest.recording_s / 3600.0, source.sent, kept, inside if is_attack else None)


@dataclass
class Tape:
    """A recording without messages: what `BlackBox` needs of a `Recorder`."""

    start_s: float
    ended: str = ""
    files: list[float] = field(default_factory=list)  # when each later file begins

    def forget(self, now_s: float, before_s: float, _latched: object) -> None:
        """Begin a file, and forget those that are over."""
        self.files.append(now_s)
        while self.files[0] <= before_s:
            self.start_s = self.files.pop(0)


def pieces(alarms: Sequence[float], length_s: float) -> Iterator[tuple[float, float]]:
    """Yield begin and end of what is kept of a drive [s]; alarms in order of time."""
    tape, box, is_kept, waiting = Tape(0.0), BlackBox(KEEP), False, list(alarms)
    for now_s in (*np.arange(INTERVAL_S, length_s, INTERVAL_S).tolist(), length_s):
        while waiting and waiting[0] <= now_s:
            box.alarm(waiting.pop(0), {})
            is_kept = True
        if box.is_complete(cast(Recorder, tape), now_s, ()):
            yield tape.start_s, now_s
            tape, box, is_kept = Tape(now_s), BlackBox(KEEP), False
    if is_kept:
        yield tape.start_s, length_s


def from_tables(campaign: Path) -> Iterator[Outcome]:
    """Yield what becomes of each run of a campaign but its controls, by its windows."""
    datasets = campaign / "datasets"
    reference = read_reference([datasets / "features.parquet"], build_manager())
    truth: dict[Any, dict[str, float]] = (
        read_table(datasets / "truth.parquet").set_index("run_id")[["recording_s", "onset_s"]]
    ).T.to_dict()  # fmt: skip
    runs = reference.table[reference.table["label"] != "control"]
    first = runs["block"] < runs["block"].median()
    for own in (first, ~first):
        raised = alarms_of(reference, runs[own], runs[~own & (runs["label"] == "normal")])
        for run_id, label in zip(runs["run_id"][own], runs["label"][own], strict=True):
            length_s, onset_s = truth[run_id]["recording_s"], truth[run_id]["onset_s"]
            kept = list(pieces(raised.get(run_id, []), length_s))
            inside = any(begin <= onset_s <= end for begin, end in kept)
            is_attack = label == "malicious" and np.isfinite(onset_s)
            kept_s = sum(end - begin for begin, end in kept)
            yield Outcome(length_s / 3600.0, length_s, kept_s, inside if is_attack else None)


def alarms_of(
    reference: Reference, judged: pd.DataFrame, normal: pd.DataFrame
) -> dict[str, list[float]]:
    """Return the times of alarms in each run [s], by a card of normal runs."""
    windows = reference.windows
    assert windows is not None  # noqa: S101 -- a campaign has windows
    learned_from = windows[windows["run_id"].isin(normal["run_id"])]
    scorer = learn(replace(reference, table=normal, windows=learned_from)).scorer
    assert scorer.windows_ is not None  # noqa: S101 -- learned with windows
    rule = scorer.windows_.rule(max(RATE_PER_H, scorer.windows_.lowest_rate()))
    windows = windows[windows["run_id"].isin(judged["run_id"])]
    ends_s = windows[WINDOW_START].to_numpy(dtype=np.float64) + WINDOW_S
    rows = (ends_s, scorer.window_scores(windows), scorer.window_families(windows))
    watches: dict[str, AlarmWatch] = {}
    raised: dict[str, list[float]] = {}
    for run_id, end_s, score, families in zip(windows["run_id"], *rows, strict=True):
        if watches.setdefault(run_id, AlarmWatch(rule)).feed(end_s, score, families) is not None:
            raised.setdefault(run_id, []).append(float(end_s))
    return raised


def main() -> None:
    """Print what becomes of each run, and both figures."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("paths", type=Path, nargs="*", metavar="CARD RUN...")
    parser.add_argument("--tables", type=Path, metavar="CAMPAIGN")
    options = parser.parse_args()
    told, card = [] if options.tables is None else list(from_tables(options.tables)), Path()
    for path in options.paths:
        if path.is_file():
            card = path
        else:
            told.append(outcome(path, card))
            print(f"{path}: {told[-1]}", flush=True)
    if attacks := [each.inside for each in told if each.inside is not None]:
        share = clopper_pearson(sum(attacks) / len(attacks), len(attacks))
        print(f"Onsets inside a kept recording: {share}, of {len(attacks)}.")
    if drives := [each for each in told if each.inside is None]:
        sizes = np.array([(each.kept, each.sent) for each in drives])
        drawn = np.random.default_rng(0).integers(len(sizes), size=(2000, len(sizes)))
        kept, sent = np.moveaxis(sizes[drawn].sum(axis=1), -1, 0)
        low, high = np.quantile(kept / sent, [0.025, 0.975])
        hours, share = sum(each.hours for each in drives), sizes[:, 0].sum() / sizes[:, 1].sum()
        print(f"Kept of {hours:.2f} h of driving: {share:.1%} ({low:.1%} to {high:.1%}).")


if __name__ == "__main__":
    main()
