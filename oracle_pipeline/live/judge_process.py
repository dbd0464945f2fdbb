"""Judges windows in a separate process, so that messages never wait for features.

The watch sends messages as they arrive, and reports when a window has ended. The process returns
verdicts. On a machine that is too slow, old windows are left out, so verdicts never lag far behind.
"""

import contextlib
import multiprocessing
import queue
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TypeAlias

from rosbags.interfaces import Qos

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.processes import no_program
from oracle_pipeline.bags.reader import RawMessage
from oracle_pipeline.features import build_manager
from oracle_pipeline.features.engine.kept_rows import Carried
from oracle_pipeline.features.extraction import extract_window
from oracle_pipeline.graphs.intervals import Interval
from oracle_pipeline.live.events import WindowVerdict
from oracle_pipeline.live.recent import CONTEXT_S, RecentMessages
from oracle_pipeline.robots.robot import find_robots
from oracle_pipeline.scoring.alarms import AlarmWatch
from oracle_pipeline.scoring.contract import Contract

_END_S = 10.0  # until the process is killed
_INBOX = 10_000  # requests that may wait
_MOST_WAITING = 2  # newer windows that make the process leave one out
_MOST_BEHIND = 12  # windows without an answer, at which it gets no more messages
_SECOND_NS = 1_000_000_000
_CONTEXT_NS = round(CONTEXT_S * _SECOND_NS)


@dataclass(frozen=True, slots=True)
class _Topic:
    """A topic, or more publishers of one."""

    name: str
    msgtype: str
    qos: tuple[Qos, ...]


@dataclass(frozen=True, slots=True)
class _Window:
    """A window that has ended; times are stamps [ns]."""

    recording_ns: int  # when the recording began
    start_ns: int
    end_ns: int
    ended_at: float  # by the monotonic clock of the machine [s]
    timed: bool  # whether the times and numbers of its messages are the robot's


@dataclass(slots=True)
class _JudgedRobot:
    """What the verdicts on the windows of a robot depend on."""

    alarms: AlarmWatch
    carried: Carried = field(default_factory=dict)  # of the window before


@dataclass(frozen=True, slots=True)
class _Begin:
    """Another segment begins: what came before does not belong to it."""


_Request: TypeAlias = _Topic | _Begin | _Window | Interval | list[RawMessage] | None
_Verdicts: TypeAlias = list[WindowVerdict]  # one for each robot; none if the window is left out


class JudgeProcess:
    """Owns the process that judges windows, and talks to it.

    Parameters
    ----------
    card : Path
        The reference card.
    alarms_per_h : float or None
        As for `WindowScorer`.
    plugins : Path, optional
        Folder of feature plugins.

    Attributes
    ----------
    contract : Contract or None
        Of the card.
    left_out : int
        Windows that were not judged, because the machine is too slow.
    """

    def __init__(self, card: Path, alarms_per_h: float | None, plugins: Path | None = None) -> None:
        self.left_out = 0
        self._behind = 0  # windows without an answer
        self._of_before = 0  # of these, how many are of a segment that has ended
        self._blind_until_ns = 0  # windows that begin earlier lack messages
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_work, args=(theirs, card, alarms_per_h, plugins), name="judge"
        )
        try:
            with no_program(), _without_interrupts():
                self._process.start()
            theirs.close()
            self.contract = self._first_answer()
        except BaseException:  # of Ctrl-C, too: the process ends with its pipe
            self._pipe.close()
            raise

    def add_topic(self, name: str, msgtype: str, qos: tuple[Qos, ...]) -> None:
        """Announce a topic, or more publishers of it."""
        self._send(_Topic(name, msgtype, qos))

    def begin(self) -> None:
        """Begin another segment; its messages start anew.

        Windows of the one before that have no verdict yet are left out.
        """
        self._of_before = self._behind
        self._send(_Begin())

    def add(self, messages: list[RawMessage]) -> None:
        """Send messages, in order of time; none while the process is far behind."""
        if self._behind < _MOST_BEHIND:
            self._send(messages)

    def add_graph(self, interval: Interval) -> None:
        """Send the graph of an interval."""
        self._send(interval)

    def end_window(
        self, recording_ns: int, start_ns: int, end_ns: int, *, timed: bool = True
    ) -> None:
        """Request the verdict on a window that has ended.

        Parameters
        ----------
        recording_ns, start_ns, end_ns : int
            When the recording and the window began, and the window ended, as stamps.
        timed : bool
            Whether features of rate and timing count.
        """
        if self._behind >= _MOST_BEHIND:
            self._blind_until_ns = end_ns + _CONTEXT_NS
        if start_ns < self._blind_until_ns:  # it lacks messages
            self.left_out += 1
        else:
            self._behind += 1
            self._send(_Window(recording_ns, start_ns, end_ns, time.monotonic(), timed))

    def verdicts(self, timeout_s: float = 0.0) -> Iterator[WindowVerdict]:
        """Yield the verdicts that have arrived, or arrive within some time of each other.

        Raises
        ------
        OracleError
            If the process died, or a window could not be judged.
        """
        try:
            while self._pipe.poll(timeout_s if self._behind else 0.0):
                answer: _Verdicts | OracleError = self._pipe.recv()
                self._behind -= 1
                if isinstance(answer, OracleError):
                    raise answer
                is_late = self._of_before > 0
                self._of_before -= is_late
                if is_late or not answer:
                    self.left_out += 1
                else:
                    yield from answer
        except (EOFError, ConnectionError):
            raise self._death() from None

    def close(self) -> list[WindowVerdict]:
        """End the process; return the verdicts on windows that had ended before."""
        last: _Verdicts = []
        until = time.monotonic() + _END_S
        try:
            self._pipe.send(None)
            while self._pipe.poll(max(0.0, until - time.monotonic())):
                answer = self._pipe.recv()
                if isinstance(answer, list):
                    last += answer
        except (EOFError, OSError):
            pass  # it has ended
        self._process.join(max(0.0, until - time.monotonic()))
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._pipe.close()
        return last

    def _first_answer(self) -> Contract | None:
        """Return the contract of the card; a bad card raises an error at once."""
        try:
            answer: Contract | OracleError | None = self._pipe.recv()
        except (EOFError, ConnectionError):
            raise self._death() from None
        if isinstance(answer, OracleError):
            raise answer
        return answer

    def _send(self, request: _Request) -> None:
        with contextlib.suppress(OSError):  # it has died; `verdicts` raises the error
            self._pipe.send(request)

    def _death(self) -> OracleError:
        self._process.join(_END_S)
        return OracleError(
            f"The process that judges windows died (exit code {self._process.exitcode}); perhaps "
            "there was not enough memory for it. What was recorded is kept."
        )


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block Ctrl-C in processes that are started meanwhile: the watch ends, and ends them."""
    resource_tracker.ensure_running()  # its start would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(pipe: Connection, card: Path, alarms_per_h: float | None, plugins: Path | None) -> None:
    """Judge windows in the other process, until the end is requested."""
    # Not by the process that records, which begins a second earlier without scikit-learn.
    from oracle_pipeline.live.window_scorer import WindowScorer
    from oracle_pipeline.scoring.card import ReferenceCard

    try:
        reference = ReferenceCard.load(card)
        manager = build_manager(plugins)
        scorer = WindowScorer(reference, alarms_per_h)
        pipe.send(reference.contract)
        # A thread empties the pipe while a window is judged, so that the watch need not wait.
        inbox = _Inbox(pipe)
        recent = RecentMessages()
        robots: dict[str, _JudgedRobot] = {}
        while (request := inbox.take()) is not None:
            if isinstance(request, list):
                recent.add(request)
            elif isinstance(request, Interval):
                recent.add_graph(request)
            elif isinstance(request, _Begin):
                recent.clear()
                robots.clear()
            elif isinstance(request, _Topic):
                recent.add_topic(request.name, request.msgtype, request.qos)
            elif inbox.windows > _MOST_WAITING:
                pipe.send([])
            else:
                run = recent.until(request.recording_ns, request.end_ns)
                start_s = (request.start_ns - request.recording_ns) / _SECOND_NS
                if not request.timed:
                    run.disturbances.begin(start_s)
                end_s = (request.end_ns - request.recording_ns) / _SECOND_NS
                found = []
                for robot in find_robots(run.bag, reference.roles):
                    own = robots.setdefault(robot.name, _JudgedRobot(AlarmWatch(scorer.rule)))
                    row, own.carried = extract_window(
                        run, manager, start_s, own.carried, robot, signals=scorer.uses_signals
                    )
                    verdict = scorer.judge(row, end_s, own.alarms)
                    found.append(replace(verdict, robot=robot.name))
                latency_s = time.monotonic() - request.ended_at
                pipe.send([replace(v, latency_s=latency_s, timed=request.timed) for v in found])
    except OracleError as error:
        pipe.send(error)
    except BrokenPipeError:
        pass  # the watch is gone
    finally:
        pipe.close()


class _Inbox:
    """Queue of requests; a thread receives them until the watch closes the pipe."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._waiting: queue.Queue[_Request] = queue.Queue(_INBOX)
        self._received = self._taken = 0  # numbers of windows
        threading.Thread(target=self._receive, daemon=True).start()

    @property
    def windows(self) -> int:
        """Number of waiting windows."""
        return self._received - self._taken

    def take(self) -> _Request:
        """Wait for the oldest request; None is the end."""
        request = self._waiting.get()
        self._taken += isinstance(request, _Window)
        return request

    def _receive(self) -> None:
        request: _Request = []
        while request is not None:
            try:
                request = self._pipe.recv()
            except (EOFError, OSError):
                request = None
            self._received += isinstance(request, _Window)
            self._waiting.put(request)
