"""A stretch of a watch during which time ran on: its windows, intervals and recording.

A step of the clock ends it, and another one begins. Windows and intervals exist only where messages
are, so a silent hour costs nothing.
"""

from collections.abc import Callable

from oracle_pipeline.bags.discovery import Discovery
from oracle_pipeline.bags.disturbances import Disturbances
from oracle_pipeline.bags.protocol import INTERVAL_S, MIN_INTERVAL_S
from oracle_pipeline.bags.reader import RawMessage
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.live.contract_watch import ContractWatch
from oracle_pipeline.live.events import ContractAlarm, Event, GraphTaken, WindowVerdict
from oracle_pipeline.live.graph_snapshot import snapshot
from oracle_pipeline.live.intake import PACKETS_S
from oracle_pipeline.live.judge_process import JudgeProcess
from oracle_pipeline.live.recorder import Recorder
from oracle_pipeline.live.time_base import Stamped
from oracle_pipeline.windows import HOP_S, WINDOW_S

_SECOND_NS = 1_000_000_000
_HOP_NS, _WINDOW_NS = round(HOP_S * 1e9), round(WINDOW_S * 1e9)
_INTERVAL_NS = round(INTERVAL_S * 1e9)


class Segment:
    """Records, counts and judges the messages of one stretch.

    Parameters
    ----------
    start_ns : int
        Stamp of its first message.
    discovery : Discovery
    judge : JudgeProcess or None
    contract : ContractWatch or None
    recorder : Recorder or None
    report : callable
        Takes events.
    turn : callable, optional
        Takes the recorder at the end of an interval [s], and returns that of the next.

    Attributes
    ----------
    disturbances : Disturbances
        Missing values, and when it was disturbed.
    """

    def __init__(
        self, start_ns: int, discovery: Discovery, judge: JudgeProcess | None,
        contract: ContractWatch | None, recorder: Recorder | None,
        report: Callable[[Event], None], turn: Callable[[Recorder, float], Recorder] | None = None,
    ) -> None:  # fmt: skip
        self.start_ns = start_ns
        self.recorder = recorder
        self.disturbances = Disturbances()
        self._now_ns = self._newest_ns = start_ns
        self._discovery, self._report = discovery, report
        self._judge, self._contract, self._turn = judge, contract, turn
        self._fresh: list[RawMessage] = []  # that the judge has not got yet
        self._sent: dict[int, tuple[int, int]] = {}  # messages and bytes of the interval
        self._interval = 0  # number of the current one
        self._window = 0  # number of the next one to end
        self._second = 1  # at which the contract is checked next

    @property
    def duration_s(self) -> float:
        """Length so far [s]."""
        return (self._now_ns - self.start_ns) / _SECOND_NS

    def is_over(self, stamp_ns: int, length_s: float) -> bool:
        """Return whether a message is later than a length of the segment."""
        return stamp_ns - self.start_ns >= length_s * _SECOND_NS

    def add(self, stamped: Stamped) -> None:
        """Take a message; stamps never run back."""
        message, stamp_ns = stamped
        self.advance_to(stamp_ns)
        self._newest_ns = stamp_ns
        if self._contract is not None:
            self._contract.add(message.topic, self.duration_s, message.data)
        messages, size = self._sent.get(message.writer, (0, 0))
        self._sent[message.writer] = messages + 1, size + len(message.data)
        if self.recorder is not None:
            self.recorder.write(message.topic, stamp_ns, message.data)
        if self._judge is not None:
            self._fresh.append(RawMessage(message.topic, stamp_ns, message.data))

    def advance_to(self, stamp_ns: int) -> None:
        """End the windows and intervals that are over and have a message; leave out the others."""
        while self._newest_ns >= self._window * _HOP_NS + self.start_ns and self._is_over(stamp_ns):
            self._end_window()
        if self._is_over(stamp_ns):
            self._skip_to(stamp_ns - self.start_ns)
        self._now_ns = max(self._now_ns, stamp_ns)
        self._check_contract()

    def disturb(self, losses: Disturbances) -> None:
        """Take note that messages were lost or late in the last second, and until `settle`."""
        self.disturbances.begin(max(0.0, self.duration_s - PACKETS_S))
        self.disturbances.add(losses)

    def settle(self) -> None:
        """End a disturbance: what comes next is on time."""
        self.disturbances.end(self.duration_s)

    def forward(self) -> None:
        """Send the judge what came since the last call."""
        if self._judge is not None and self._fresh:
            self._judge.add(self._fresh)
            self._fresh = []

    def end(self) -> None:
        """End the last interval, if it is long enough."""
        self.forward()
        rest_s = self.duration_s - self._interval * INTERVAL_S
        if self._sent and rest_s >= MIN_INTERVAL_S and self._discovery.topics():
            self._end_interval()

    def _is_over(self, stamp_ns: int) -> bool:
        """Return whether a window has ended; each interval ends together with a window."""
        return stamp_ns >= self.start_ns + self._window * _HOP_NS + _WINDOW_NS

    def _end_window(self) -> None:
        begin_ns = self._window * _HOP_NS
        end_ns = begin_ns + _WINDOW_NS
        self.forward()
        if end_ns >= (self._interval + 1) * _INTERVAL_NS:
            self._end_interval()
            self._turn_over()
        begin_s, end_s = begin_ns / _SECOND_NS, end_ns / _SECOND_NS
        if self._judge is not None and not self._is_there(begin_s):
            self._report(WindowVerdict(begin_s, end_s, 0.0, 1.0, True, False, judged=False))
        elif self._judge is not None:
            start_ns = self.start_ns
            timed = not self.disturbances.cover(begin_s, end_s)
            self._judge.end_window(start_ns, start_ns + begin_ns, start_ns + end_ns, timed=timed)
        self._window += 1

    def _is_there(self, since_s: float) -> bool:
        """Return whether the robot had started by a time, and has not left."""
        is_up = self._contract is None or self._contract.is_up(since_s)
        return is_up and bool(self._discovery.topics())

    def _skip_to(self, passed_ns: int) -> None:
        """Go to the window and interval of a time, past those in which nothing came."""
        self._window = (passed_ns - _WINDOW_NS) // _HOP_NS + 1
        if passed_ns >= (self._interval + 1) * _INTERVAL_NS:
            if self._sent:
                self._end_interval()
            self._interval = passed_ns // _INTERVAL_NS
            self._turn_over()

    def _turn_over(self) -> None:
        if self._turn is not None and self.recorder is not None:
            self.recorder = self._turn(self.recorder, self._interval * INTERVAL_S)

    def _end_interval(self) -> None:
        start_s = self._interval * INTERVAL_S
        graph = snapshot(self._discovery, self._sent)
        self._sent.clear()
        self._interval += 1
        if self.recorder is not None:
            self.recorder.write_graph(start_s, graph)
        is_whole = self._contract is None or self._contract.is_whole(graph)
        if self._judge is not None and is_whole and self._is_there(start_s):
            self._judge.add_graph(Interval(float(start_s), graph))
        self._report(GraphTaken(start_s, graph))

    def _check_contract(self) -> None:
        """Compare the robot with the contract, once for each second."""
        if self._contract is None or self.duration_s < self._second:
            return
        now_s = self.duration_s
        self._second = int(now_s) + 1
        if self.disturbances.cover(now_s - 1.0, now_s):
            self._contract.forget()
        if breaches := self._contract.check(now_s, self._discovery):
            self._report(ContractAlarm(now_s, breaches))
