"""Replay recorded runs to a watch with a black box: how much of attacks and of driving it keeps.

``python -m tools.bench.black_box CARD RUN... [CARD RUN...]`` plays runs to `Watch`, as a source of
messages in place of a domain, as fast as windows are judged. A card judges the runs after it, of
other blocks. An onset counts as kept if it is inside a recording that is left; bytes are those of
messages.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rosbags.interfaces import QosDurability, QosReliability

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.protocol import INTERVAL_S
from oracle_pipeline.bags.run_directory import MANIFEST_FILE
from oracle_pipeline.evaluation.estimate import clopper_pearson
from oracle_pipeline.live.black_box import Keep
from oracle_pipeline.live.discovery import ENTITIES_QOS, Discovery, Endpoint
from oracle_pipeline.live.intake import Intake, Received
from oracle_pipeline.live.source import Source
from oracle_pipeline.live.watch import Watch
from oracle_pipeline.live.window_scorer import WindowVerdict
from oracle_pipeline.opened_run import OpenedRun, open_run
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
    sent: int  # [B]
    kept: int  # [B]
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
                inside |= run.bag.start_ns <= onset_ns <= run.bag.end_ns
    is_attack = manifest.label == "malicious" and manifest.onset_s is not None
    return Outcome(manifest.recording_s / 3600.0, source.sent, kept, inside if is_attack else None)


def main() -> None:
    """Print what becomes of each run, and both figures."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("paths", type=Path, nargs="+", metavar="CARD RUN...")
    told, card = list[Outcome](), Path()
    for path in parser.parse_args().paths:
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
        print(f"Bytes kept of {hours:.2f} h of driving: {share:.1%} ({low:.1%} to {high:.1%}).")


if __name__ == "__main__":
    main()
