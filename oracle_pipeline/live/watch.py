"""Watches a running system: records and judges its messages, and reports events as they happen.

``oracle watch`` uses ``Watch``. It only reads, and never publishes.
"""

import itertools
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from time import monotonic, monotonic_ns
from typing import Any, Self

from oracle_pipeline.bags.discovery import Endpoint
from oracle_pipeline.bags.disturbances import Disturbances
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.limits import MOST_CHANNELS
from oracle_pipeline.bags.protocol import is_hidden
from oracle_pipeline.bags.qos_profiles import is_latched, is_reliable
from oracle_pipeline.live import events
from oracle_pipeline.live.black_box import BlackBox, Keep
from oracle_pipeline.live.contract_watch import ContractWatch
from oracle_pipeline.live.intake import Received
from oracle_pipeline.live.judge_process import JudgeProcess
from oracle_pipeline.live.recorder import Recorder
from oracle_pipeline.live.segment import Segment
from oracle_pipeline.live.source import Source
from oracle_pipeline.live.split_bag import Message, Split
from oracle_pipeline.live.time_base import CLOCK_TOPIC, RobotTime, Stamped, Step

_SETTLE_S = 2.0  # from the first topic until discovery is taken to be complete
_DISCOVERY_S = 0.1  # rosbag2 looks for new topics this often
_FLUSH_S = 1.0  # of what is lost at most if the watch is killed
_VERDICT_S = 5.0  # that a segment waits for a verdict on one of its windows
_LATCHED = 20  # newest messages of a latched topic, with which another segment begins


class Watch:
    """Watches a source of messages; a context manager, and an iterator over events.

    Each segment, from one step of the clock to the next, is a recording of its own. However the
    watch ends, its recordings are complete.

    Parameters
    ----------
    source : Source
        Of the messages, such as a `Domain`; the watch closes it.
    card : Path, optional
        Reference card to judge windows by; without one, nothing is judged.
    folder : Path, optional
        Folder that recordings go into; without one, nothing is recorded.
    name : str
        Name of the first recording; others have a number behind it.
    split : Split
        When a file of a recording ends.
    piece_s : float
        Length of a segment, after which another one begins [s].
    keep : Keep, optional
        What is kept around alarms; by default everything is.
    keep_free_bytes : int, optional
        Free space at which recording ends; by default as for `Recorder`.
    alarms_per_h : float, optional
        As for `WindowScorer`.
    plugins : Path, optional
        Folder of feature plugins.

    Attributes
    ----------
    losses : Disturbances
        What was lost, in all segments.
    received : int
        Messages that were processed.
    recordings : list of Path
        Of all segments.

    Examples
    --------
    >>> with Watch(Domain(0), folder=Path("recordings"), name="today") as watch:
    ...     for event in watch:
    ...         print(event)
    """

    def __init__(
        self,
        source: Source,
        *,
        card: Path | None = None,
        folder: Path | None = None,
        name: str = "recording",
        split: Split = Split(),  # noqa: B008 -- immutable
        piece_s: float = math.inf,
        keep: Keep | None = None,
        keep_free_bytes: int | None = None,
        alarms_per_h: float | None = None,
        plugins: Path | None = None,
    ) -> None:
        self.losses = Disturbances()
        self.received = 0
        self.recordings: list[Path] = []
        self._source, self._folder, self._name = source, folder, name
        self._split, self._piece_s, self._keep_free_bytes = split, piece_s, keep_free_bytes
        self._black_box = None if keep is None else BlackBox(keep)
        self._triggers = frozenset() if keep is None else keep.topics
        self._stopped = False
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)  # an unusable folder raises an error at once
        self._judge = None if card is None else JudgeProcess(card, alarms_per_h, plugins)
        self._contract = None if self._judge is None else self._judge.contract
        self.discovery, self._intake = source.discovery, source.intake
        self._announced: dict[str, list[Endpoint]] = {}  # publishers so far, by topic
        self._unsupported: set[str] = set()  # topics that cannot be recorded
        self._latched: dict[str, deque[Stamped]] = {}
        self._time = RobotTime(simulated=False)
        self._segment: Segment | None = None
        self._early = Disturbances()  # what was lost just before a segment
        self._pending: deque[events.Event] = deque()

    def stop(self) -> None:
        """End the iteration soon; a signal handler or another thread may call it."""
        self._stopped = True

    def trigger(self, reason: str) -> None:
        """Keep the time around now, with a black box; a signal handler may call it."""
        if self._segment is not None and self._black_box is not None:
            self._pending.append(events.Note(f"The time around now is kept: {reason}."))
            self._black_box.alarm(self._segment.duration_s, {"trigger": reason})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: Any) -> None:
        try:
            self._end_segment()
        finally:
            self._source.close()
            if self._judge is not None:
                self._judge.close()

    def __iter__(self) -> Iterator[events.Event]:
        """Yield events until `stop` is called."""
        self._settle()
        discovered = flushed = 0.0
        while not self._stopped:
            is_busy = self._source.pause()
            before_ns = monotonic_ns()
            came = self._intake.take()
            self._count_losses(is_busy=is_busy)
            if monotonic() - discovered >= _DISCOVERY_S:
                discovered = monotonic()
                self._discover()
            yield from self._process(came)
            if not came:
                self._pass_time(before_ns)
            if self._segment is not None:
                self._segment.settle()
            if monotonic() - flushed >= _FLUSH_S:
                flushed = monotonic()
                self._flush()
            self._collect()
            if self._source.calls():
                self.trigger("a call of the service")
            while self._pending:
                yield self._pending.popleft()
        yield from self._finish()

    def _settle(self) -> None:
        """Wait until the nodes of the system are known, and choose the time base."""
        until = None
        while (until is None or monotonic() < until) and not self._stopped:
            self.discovery.update()
            if until is None and self.discovery.topics():
                until = monotonic() + _SETTLE_S
            self._source.pause()
        self._time = RobotTime(simulated=CLOCK_TOPIC in self.discovery.topics())
        self._discover(force=True)

    # Topics.

    def _discover(self, *, force: bool = False) -> None:
        """Subscribe to new topics."""
        if not self.discovery.update() and not force:
            return
        for topic, publishers in self.discovery.topics().items():
            if (
                is_hidden(topic)
                or topic in self._unsupported
                or len(self._announced) >= MOST_CHANNELS
            ):
                continue
            known = len(self._announced.get(topic, ()))
            if not known:
                self._subscribe(topic, publishers)
            if topic in self._intake.topics and len(publishers) > known:
                self._announce(topic, publishers[known:])
                self._announced.setdefault(topic, []).extend(publishers[known:])

    def _subscribe(self, topic: str, publishers: list[Endpoint]) -> None:
        latched = all(is_latched(each.qos) for each in publishers)
        reliable = all(is_reliable(each.qos) for each in publishers)
        try:
            self._intake.subscribe(topic, publishers[0].msgtype, reliable=reliable, latched=latched)
        except OracleError as error:
            self._unsupported.add(topic)
            self._pending.append(events.Note(f"{topic} is not recorded: {error}"))
            return
        if latched:
            self._latched[topic] = deque(maxlen=_LATCHED)

    def _announce(self, topic: str, publishers: list[Endpoint]) -> None:
        if not all(self._intake.accepts(topic, each.qos) for each in publishers):
            self._pending.append(
                events.Note(
                    f"A later publisher of {topic} offers a QoS that is not compatible with the "
                    "subscription, so its messages are not received. Start the watch again to "
                    "receive all."
                )
            )
        msgtype, profiles = self._intake.topics[topic], tuple(each.qos for each in publishers)
        if self._segment is not None and self._segment.recorder is not None:
            self._segment.recorder.add_topic(topic, msgtype, profiles)
        if self._judge is not None:
            self._judge.add_topic(topic, msgtype, profiles)

    # Messages.

    def _process(self, came: list[Received]) -> Iterator[events.Event]:
        """Pass messages to the segment that they belong to."""
        for each in self._time.stamped(came):
            if isinstance(each, Step):
                self._step(each)
                continue
            if self._segment is not None and self._segment.is_over(each.stamp_ns, self._piece_s):
                self._end_segment()
            if self._segment is None:
                self._begin(each.stamp_ns)
            message, stamp_ns = each
            self._add(each)
            self.received += 1
            if message.topic in self._latched:
                self._latched[message.topic].append(each)
            if message.topic in self._triggers:
                self.trigger(f"a message on {message.topic}")
            msgtype = self._intake.topics[message.topic]
            yield events.MessageReceived(message.topic, msgtype, stamp_ns, message.data)
        if self._segment is not None:
            self._segment.forward()

    def _add(self, stamped: Stamped) -> None:
        if self._segment is not None:
            self._segment.add(stamped)

    def _pass_time(self, steady_ns: int) -> None:
        """Let time go on though nothing came."""
        now_ns = self._time.now_ns(steady_ns)
        if self._segment is not None and now_ns is not None:
            self._segment.advance_to(now_ns)

    def _count_losses(self, *, is_busy: bool = False) -> None:
        """Take note of what was lost since the last call, or is late."""
        new = Disturbances(self._intake.lost(), self._intake.lost_packets())
        self.losses.add(new)
        if told := new.loss():
            self._pending.append(events.Note(told))
        if self._segment is None:
            self._early.add(new)
        elif told or is_busy:
            self._segment.disturb(new)

    # Segments.

    def _begin(self, start_ns: int) -> None:
        """Begin a segment, with the latched messages of the one before."""
        self._segment = Segment(
            start_ns, self.discovery, self._judge,
            None if self._contract is None else ContractWatch(self._contract, self._intake.topics),
            self._recorder(start_ns), self._report, None if self._black_box is None else self._turn,
        )  # fmt: skip
        if self._early.loss():
            self._segment.disturb(self._early)
        self._early = Disturbances()
        for kept in self._latched.values():
            for message, _ in kept:
                self._add(Stamped(message, start_ns))

    def _turn(self, recorder: Recorder, now_s: float) -> Recorder:
        """Return the recorder of the next interval, for the black box."""
        assert self._black_box is not None  # noqa: S101 -- there is a black box
        assert self._segment is not None  # noqa: S101 -- its interval has ended
        latched = [
            Message(message.topic, stamp_ns, message.data)
            for kept in self._latched.values()
            for message, stamp_ns in kept
        ]
        if not self._black_box.is_complete(recorder, now_s, latched):
            return recorder
        self._close(recorder)
        start_ns = self._segment.start_ns + round(now_s * 1e9)
        following = self._recorder(start_ns, now_s)
        assert following is not None  # noqa: S101 -- the one before had a folder, too
        for message in latched:
            following.write(message.topic, start_ns, message.data)
        return following

    def _recorder(self, start_ns: int, start_s: float = 0.0) -> Recorder | None:
        if self._folder is None:
            return None
        facts = {**self._source.facts, "time": self._time.name, "start_ns": start_ns}
        names = itertools.chain([self._name], (f"{self._name}_{n}" for n in itertools.count(2)))
        path = next(p for name in names if not (p := self._folder / name).exists())
        recorder = Recorder(path, facts, self._split, self._keep_free_bytes, start_s)
        for topic, publishers in self._announced.items():
            profiles = [each.qos for each in publishers]
            recorder.add_topic(topic, self._intake.topics[topic], profiles)
        self.recordings.append(recorder.path)
        return recorder

    def _step(self, step: Step) -> None:
        """End the segment; the next message begins another one."""
        if self._segment is not None:
            self._pending.append(events.Note(f"{step.reason} Another recording begins."))
            self._collect(_VERDICT_S)
            self._end_segment()
            if self._judge is not None:
                self._judge.begin()
        else:
            self._pending.append(events.Note(step.reason))

    def _flush(self) -> None:
        """Write what was recorded to the disk."""
        recorder = None if self._segment is None else self._segment.recorder
        if recorder is None or recorder.ended:
            return
        recorder.facts |= self._facts(recorder)
        recorder.flush()
        if recorder.ended:
            self._pending.append(events.Note(f"Nothing more is recorded: {recorder.ended}."))

    def _facts(self, recorder: Recorder) -> dict[str, Any]:
        assert self._segment is not None  # noqa: S101 -- set by the first message
        begin_s, now_s = recorder.start_s, self._segment.duration_s
        lacking = self._segment.disturbances.to_dict(begin_s, now_s)
        return {"recording_s": now_s - begin_s, **lacking}

    def _close(self, recorder: Recorder) -> None:
        """Complete a recording, if it is kept."""
        recorder.facts |= self._facts(recorder)
        if self._black_box is None:
            recorder.close()
        elif self._black_box.take(recorder):
            self._pending.append(events.Note(f"Kept: {recorder.path}", recorder.path))
        self.recordings = [path for path in self.recordings if path.exists()]

    def _end_segment(self) -> None:
        """End the segment, and complete its recording."""
        if self._segment is None:
            return
        self._segment.end()
        if self._segment.recorder is not None:
            self._close(self._segment.recorder)
        self._segment = None

    # Verdicts.

    def _collect(self, timeout_s: float = 0.0) -> None:
        """Collect new verdicts, and wait for those that are still to come."""
        if self._judge is not None:
            try:
                before = self._judge.left_out
                for verdict in self._judge.verdicts(timeout_s):
                    self._judged(verdict)
                if left_out := self._judge.left_out - before:
                    told = f"{left_out} windows were not judged: this machine is too slow."
                    self._pending.append(events.Note(told))
            except OracleError as error:  # the recording goes on
                self._judge.close()
                self._judge = None
                self._pending.append(events.Note(str(error)))

    def _judged(self, verdict: events.WindowVerdict) -> None:
        self._pending.append(verdict)
        if verdict.alarm:
            self._report(events.WindowAlarm(verdict))

    def _report(self, event: events.Event) -> None:
        """Pass on an event; an alarm is kept."""
        self._pending.append(event)
        if self._black_box is None:
            return
        if isinstance(event, events.WindowAlarm):
            self._black_box.alarm(event.verdict.end_s, asdict(event.verdict))
        elif isinstance(event, events.ContractAlarm):
            told = {"contract": [breach.text for breach in event.breaches]}
            self._black_box.alarm(event.at_s, told)

    def _finish(self) -> Iterator[events.Event]:
        """Take what has come, end the segment, and wait for the last verdicts."""
        came = self._intake.take()
        self._count_losses()
        yield from self._process(came)
        if self._judge is not None:
            for verdict in self._judge.close():
                self._judged(verdict)
            self._judge = None
        self._end_segment()
        while self._pending:
            yield self._pending.popleft()
