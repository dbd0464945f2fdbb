"""Watches a DDS domain: records and judges its messages, and reports events as they happen.

``oracle watch`` uses ``Watch``. It only reads, and has no writer on the domain.
"""

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep, time_ns
from typing import Any, Self

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.errors import DdsError, OracleError
from oracle_pipeline.bags.limits import MOST_CHANNELS
from oracle_pipeline.bags.protocol import INTERVAL_S, MIN_INTERVAL_S, is_hidden
from oracle_pipeline.bags.qos_profiles import is_latched, is_reliable
from oracle_pipeline.bags.reader import RawMessage
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.live.contract_watch import ContractWatch
from oracle_pipeline.live.discovery import Discovery, Endpoint
from oracle_pipeline.live.events import (
    ContractAlarm,
    Event,
    GraphTaken,
    MessageReceived,
    Note,
    WindowAlarm,
)
from oracle_pipeline.live.graph_snapshot import snapshot
from oracle_pipeline.live.intake import QUEUE_BYTES, Intake, Received
from oracle_pipeline.live.judge_process import JudgeProcess
from oracle_pipeline.live.recorder import Recorder
from oracle_pipeline.live.time_base import CLOCK_TOPIC, SimulatedTime, WallTime
from oracle_pipeline.live.window_scorer import WindowVerdict
from oracle_pipeline.windows import HOP_S, WINDOW_S

_SETTLE_S = 2.0  # from the first topic until discovery is taken to be complete
_DISCOVERY_S = 0.1  # rosbag2 looks for new topics this often
_PAUSE_S = 0.05  # between two reads of the queue; waking up for each message costs more
_SECOND_NS = 1_000_000_000


class Watch:
    """Watches a domain; a context manager, and an iterator over events.

    Parameters
    ----------
    domain : int
        Which DDS domain.
    card : Path, optional
        Reference card to judge windows by; without one, nothing is judged.
    folder : Path, optional
        Folder of the recording; without one, nothing is recorded.
    name : str
        Of the recording.
    alarms_per_h : float, optional
        False alarms an hour that may be raised; by default what the card promises.
    plugins : Path, optional
        Folder of feature plugins.
    queue_bytes : int
        Size of the queue of received messages [B].

    Attributes
    ----------
    dropped : int
        Messages that were lost because the queue was full.
    received : int
        Messages that were processed.
    recording : Recorder or None

    Examples
    --------
    >>> with Watch(0, folder=Path("recordings"), name="today") as watch:
    ...     for event in watch:
    ...         print(event)
    """

    def __init__(
        self,
        domain: int,
        *,
        card: Path | None = None,
        folder: Path | None = None,
        name: str = "recording",
        alarms_per_h: float | None = None,
        plugins: Path | None = None,
        queue_bytes: int = QUEUE_BYTES,
    ) -> None:
        self.dropped = self.received = 0
        self._domain = domain
        self._stopped = False
        self._judge = None if card is None else JudgeProcess(card, alarms_per_h, plugins)
        contract = None if self._judge is None else self._judge.contract
        self._contract = None if contract is None else ContractWatch(contract)
        self.recording = None if folder is None else Recorder(folder, name)
        self._participant = dds.join(domain)
        self.discovery = Discovery(self._participant)
        self._intake = Intake(self._participant, queue_bytes)
        self._sent: dict[int, tuple[int, int]] = {}  # messages and bytes of the interval
        self._announced: dict[str, int] = {}  # publishers whose QoS was recorded, by topic
        self._unsupported: set[str] = set()  # topics that cannot be recorded
        self._time: WallTime | SimulatedTime = WallTime()
        self._start_ns: int | None = None
        self._now_ns = 0
        self._interval = 0  # number of the current one
        self._window = 0  # number of the next one to end
        self._second = 1  # of the recording, at which the contract is checked next
        self._pending: deque[Event] = deque()

    def stop(self) -> None:
        """End the iteration soon; a signal handler or another thread may call it."""
        self._stopped = True

    @property
    def duration_s(self) -> float:
        """Length of the recording so far [s]."""
        return 0.0 if self._start_ns is None else (self._now_ns - self._start_ns) / _SECOND_NS

    def __enter__(self) -> Self:
        if self.recording is not None:
            self.recording.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._intake.close()
        dds.leave(self._participant)
        if self._judge is not None:
            self._judge.close()
        if self.recording is not None:
            self.recording.facts = {
                "domain": self._domain,
                "time": "wall" if isinstance(self._time, WallTime) else "simulated",
                "start_ns": self._start_ns,
                "recording_s": self.duration_s,
                "dropped": self.dropped,
            }
            self.recording.__exit__(*exception)

    def __iter__(self) -> Iterator[Event]:
        """Yield events until `stop` is called."""
        self._settle()
        waiting: list[Received] = []  # until the time is known
        discovered = 0.0
        while not self._stopped:
            sleep(_PAUSE_S)
            before_ns = time_ns()
            came = self._intake.take()
            if monotonic() - discovered >= _DISCOVERY_S:
                discovered = monotonic()
                self._discover()
            waiting += came
            for received in came:
                if received.topic == CLOCK_TOPIC:
                    self._time.tick(received)
            if self._time.is_ready:
                yield from self._process(waiting)
                if not came and self._start_ns is not None:
                    self._advance_to(self._time.now_ns(before_ns))
                waiting = []
            self._collect()
            while self._pending:
                yield self._pending.popleft()
        yield from self._finish()

    def _settle(self) -> None:
        """Wait until the nodes of the domain are known, and choose the time base."""
        until = None
        while (until is None or monotonic() < until) and not self._stopped:
            self.discovery.update()
            if until is None and self.discovery.topics():
                until = monotonic() + _SETTLE_S
            sleep(_PAUSE_S)
        if CLOCK_TOPIC in self.discovery.topics():
            self._time = SimulatedTime()
        self._discover(force=True)

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
            known = self._announced.get(topic, 0)
            if not known:
                self._subscribe(topic, publishers)
            if topic in self._intake.topics and len(publishers) > known:
                self._announce(topic, publishers[known:])
            self._announced[topic] = max(known, len(publishers))

    def _subscribe(self, topic: str, publishers: list[Endpoint]) -> None:
        try:
            self._intake.subscribe(
                topic,
                publishers[0].msgtype,
                reliable=all(is_reliable(each.qos) for each in publishers),
                latched=all(is_latched(each.qos) for each in publishers),
            )
        except DdsError as error:
            self._unsupported.add(topic)
            self._pending.append(Note(f"{topic} is not recorded: {error}"))

    def _announce(self, topic: str, publishers: list[Endpoint]) -> None:
        if not all(self._intake.accepts(topic, each.qos) for each in publishers):
            self._pending.append(
                Note(
                    f"A later publisher of {topic} offers a QoS that is not compatible with the "
                    "subscription, so its messages are not received. Start the watch again to "
                    "receive all."
                )
            )
        msgtype, profiles = self._intake.topics[topic], tuple(each.qos for each in publishers)
        if self.recording is not None:
            self.recording.add_topic(topic, msgtype, profiles)
        if self._judge is not None:
            self._judge.add_topic(topic, msgtype, profiles)

    def _process(self, came: list[Received]) -> Iterator[Event]:
        """Record messages, count them, and forward them to the judge, window by window."""
        fresh: list[RawMessage] = []
        for received in came:
            stamp_ns = self._time.stamp_ns(received)
            if self._start_ns is None:
                self._start_ns = stamp_ns
            if self._is_due(stamp_ns):
                self._forward(fresh)
                fresh = []
                self._advance_to(stamp_ns)
            self._now_ns = stamp_ns
            if self._contract is not None:
                self._check_contract()
                self._contract.count(received.topic, self.duration_s)
            self.received += 1
            messages, size = self._sent.get(received.writer, (0, 0))
            self._sent[received.writer] = messages + 1, size + len(received.data)
            if self.recording is not None:
                self.recording.write(received.topic, stamp_ns, received.data)
            fresh.append(RawMessage(received.topic, stamp_ns, received.data))
            msgtype = self._intake.topics[received.topic]
            yield MessageReceived(received.topic, msgtype, stamp_ns, received.data)
        self._forward(fresh)

    def _check_contract(self) -> None:
        """Compare the robot with the contract, once for each second of the recording."""
        if self._contract is None or self.duration_s < self._second:
            return
        now_s = self.duration_s
        self._second = int(now_s) + 1
        if breaches := self._contract.check(now_s, self.discovery, self._intake.topics):
            self._pending.append(ContractAlarm(now_s, breaches))

    def _forward(self, fresh: list[RawMessage]) -> None:
        if self._judge is not None and fresh:
            self._judge.add(fresh)

    def _is_due(self, stamp_ns: int) -> bool:
        """Return whether a window has ended; each interval ends together with a window."""
        return stamp_ns >= self._window_end_ns

    @property
    def _window_end_ns(self) -> int:
        assert self._start_ns is not None  # noqa: S101 -- set by the first message
        return self._start_ns + round((self._window * HOP_S + WINDOW_S) * _SECOND_NS)

    def _advance_to(self, stamp_ns: int) -> None:
        """Advance the time of the recording: end intervals and windows that are over."""
        while self._is_due(stamp_ns):
            end_ns = self._window_end_ns
            assert self._start_ns is not None  # noqa: S101
            end_s = (end_ns - self._start_ns) / _SECOND_NS
            if end_s >= (self._interval + 1) * INTERVAL_S:
                self._end_interval()
            if self._judge is not None:
                start_ns = end_ns - round(WINDOW_S * _SECOND_NS)
                self._judge.end_window(self._start_ns, start_ns, end_ns)
            self._window += 1
        self._now_ns = max(self._now_ns, stamp_ns)
        self._check_contract()

    def _end_interval(self) -> None:
        start_s = self._interval * INTERVAL_S
        graph = snapshot(self.discovery, self._sent)
        self._sent.clear()
        self._interval += 1
        if self.recording is not None:
            self.recording.write_graph(start_s, graph)
        if self._judge is not None:
            self._judge.add_graph(Interval(float(start_s), graph))
        self._pending.append(GraphTaken(start_s, graph))

    def _collect(self) -> None:
        """Collect new verdicts and the counts of dropped messages."""
        if dropped := self._intake.dropped():
            self.dropped += dropped.total()
            listed = ", ".join(f"{topic} {count}" for topic, count in dropped.most_common(5))
            self._pending.append(
                Note(f"{dropped.total()} messages arrived too fast and were dropped ({listed}).")
            )
        if self._judge is not None:
            try:
                before = self._judge.left_out
                for verdict in self._judge.verdicts():
                    self._report(verdict)
                if left_out := self._judge.left_out - before:
                    self._pending.append(
                        Note(f"{left_out} windows were not judged: this machine is too slow.")
                    )
            except OracleError as error:  # the recording goes on
                self._judge.close()
                self._judge = None
                self._pending.append(Note(str(error)))

    def _report(self, verdict: WindowVerdict) -> None:
        self._pending.append(verdict)
        if verdict.alarm:
            self._pending.append(WindowAlarm(verdict))

    def _finish(self) -> Iterator[Event]:
        """End the last interval if it is long enough, and wait for the last verdicts."""
        if self._start_ns is not None:
            rest_s = self.duration_s - self._interval * INTERVAL_S
            if rest_s >= MIN_INTERVAL_S and self.discovery.topics():  # else the robot has left
                self._end_interval()
        if self._judge is not None:
            for verdict in self._judge.close():
                self._report(verdict)
            self._judge = None
        while self._pending:
            yield self._pending.popleft()
