"""Runs the work on recordings or cards in separate processes, with limits on time and memory.

If a recording crashes its process, the other recordings of a suite still get their verdicts.
Processes are forks, so that all modules are imported: of this process, or of a server if this one
has threads. A process takes one recording after another, until one fails.
"""

import multiprocessing
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice
from multiprocessing import connection
from multiprocessing.context import ForkContext, ForkServerContext
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np

from oracle_pipeline.bags.errors import BagError, OracleError
from oracle_pipeline.bags.processes import FINDS_OURS
from oracle_pipeline.bags.terminal import progress_bar
from oracle_pipeline.bags.worker import Worker, WorkerDied
from oracle_pipeline.features import FeatureManager, FeatureTables, build_manager, measure
from oracle_pipeline.features.engine.kept_messages import KeptMessages
from oracle_pipeline.features.engine.timeline import Stamps, Timeline
from oracle_pipeline.features.manager import FOLDER_VARIABLE
from oracle_pipeline.features.signals.collector import SignalCollector
from oracle_pipeline.opened_run import OpenedRun, open_run
from oracle_pipeline.robots.known import Known
from oracle_pipeline.robots.robot import Robot, find_robots, of_robot
from oracle_pipeline.robots.roles_file import RoleChoices
from oracle_pipeline.scoring.blocks import Origin, origin_of
from oracle_pipeline.scoring.contract import Observation, Observer

T = TypeVar("T")
#: A function on the recording at a path, and that path; both go to another process.
Job: TypeAlias = tuple[Callable[[Path], T], Path]
#: Returns sentences on a recording whose messages it gets, and a collector that has seen them.
Check: TypeAlias = Callable[[KeptMessages, SignalCollector], Sequence[str]]

MOST_AT_ONCE = 8  # processes, each of which may take gibibytes
_GIB = 2**30


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits for the work on one file."""

    seconds: float = 900.0
    gibibytes: float = 4.0  # of memory
    remedy: str = ""  # for a file that exceeds them; by default that for a recording

    def advice(self, option: str) -> str:
        """Return what to do about a file that exceeds a limit."""
        return self.remedy or f"raise it ({option}), or split the recording"


DEFAULT_LIMITS = Limits()
#: For commands that have no options for limits.
WIDE_LIMITS = Limits(3600.0, 16.0, "split the recording")


class Extracted(NamedTuple):
    """The features of one robot, as sent by the other process."""

    recording: str  # path, and name of the robot if there are several
    tables: FeatureTables
    observation: Observation
    origin: Origin
    faults: Sequence[str] = ()  # found by the check


class Reading(NamedTuple):
    """How a recording is read.

    Attributes
    ----------
    strict : bool
        Refuse an incomplete recording.
    choices : RoleChoices, optional
        Robots and topics from a roles file.
    known : Known, optional
        Topics of the reference that the recording is compared with.
    paced : bool
        Whether to measure what a reference needs: the paces of topics, and the start.
    check : callable, optional
        Looks for faults that need no reference.
    """

    strict: bool = False
    choices: RoleChoices | None = None
    known: Known | None = None
    paced: bool = False
    check: Check | None = None


def extract_each(
    paths: Sequence[Path],
    manager: FeatureManager,
    limits: Limits = DEFAULT_LIMITS,
    reading: Reading = Reading(),  # noqa: B008 -- immutable
    desc: str = "",
) -> Iterator[tuple[Path, list[Extracted] | OracleError]]:
    """Yield the features of recordings, or what is wrong with one, with a bar on the terminal.

    Parameters
    ----------
    paths : sequence of Path
        Run directories or bags.
    manager : FeatureManager
        As returned by `build_manager`; each process builds its own with the same plugins.
    limits : Limits
        Of each process.
    reading : Reading
    desc : str
        Text before the bar.
    """
    work = partial(extracted, plugins=manager.folder, reading=reading)
    found = isolated_each([(work, path) for path in paths], limits)
    bar = progress_bar(found, unit="recording", total=len(paths), desc=desc)
    yield from zip(paths, bar, strict=True)


def extracted(
    path: Path,
    plugins: Path | None = None,
    reading: Reading = Reading(),  # noqa: B008 -- immutable
) -> list[Extracted]:
    """Compute the features of a recording in this process, for each of its robots."""
    with open_run(path, strict=reading.strict) as run:
        manager = build_manager(plugins)
        robots = find_robots(run.bag, reading.choices, reading.known)
        each = [_of_robot(str(path), run, robot, manager, reading) for robot in robots]
    return [one._replace(observation=replace(one.observation, robots=len(robots))) for one in each]


def _of_robot(
    path: str, run: OpenedRun, robot: Robot, manager: FeatureManager, reading: Reading
) -> Extracted:
    observer = Observer(robot, paced=reading.paced)
    tables, faults, clock, times_ns = _tables(run, robot, manager, observer, reading.check)
    seen = interfaces(observer, run, robot, clock, times_ns)
    origin = origin_of(run, robot, starts=reading.paced)
    return Extracted(of_robot(path, robot.name), tables, seen, origin, faults)


def interfaces(
    observer: Observer, run: OpenedRun, robot: Robot, clock: Timeline, times_ns: Stamps
) -> Observation:
    """Return what was observed of the only robot of a recording, with the roles of its topics."""
    roles = {role: found.topics for role, found in robot.roles.found.items() if found.topics}
    seen = observer.observation(run, clock, times_ns)
    return replace(seen, roles=roles, instead=robot.instead, robots=1)


def _tables(
    run: OpenedRun, robot: Robot, manager: FeatureManager, observer: Observer, check: Check | None
) -> tuple[FeatureTables, Sequence[str], Timeline, Stamps]:
    """Return the features of one robot and its faults, the clock, and the times of messages.

    What was kept of the messages is freed before the observation is made.
    """
    recording = KeptMessages.read(robot, manager.plugins, see=observer.see)
    tables = measure(run, manager, robot, recording, observer.signals).frames()
    faults = check(recording, observer.signals) if check else ()
    return tables, faults, recording.clock, recording.times_ns


def run_isolated(work: Callable[[Path], T], path: Path, limits: Limits = DEFAULT_LIMITS) -> T:
    """Return the result of a function on a recording, computed in another process.

    Parameters
    ----------
    work : callable
        Takes the path and returns a picklable value; must be picklable itself.
    path : Path
        A run directory or a bag.
    limits : Limits
        Of the process.

    Raises
    ------
    OracleError
        If the function raised anything, or the process died or exceeded the limits.
    """
    (answer,) = isolated_each([(work, path)], limits)
    if isinstance(answer, OracleError):
        raise answer
    return answer


def isolated_each(
    jobs: Sequence[Job[T]], limits: Limits = DEFAULT_LIMITS
) -> Iterator[T | OracleError]:
    """Yield what `run_isolated` returns or raises for each job in turn, a few at once.

    A daemonic process may start no others, so it does the jobs itself, without limits.
    """
    if multiprocessing.current_process().daemon:
        yield from (_answer(work, path, limits) for work, path in jobs)
        return
    at_once = min(os.cpu_count() or 1, MOST_AT_ONCE)
    waiting, running, done = enumerate(jobs), dict[int, _Reader](), dict[int, T | OracleError]()
    idle: list[_Reader] = []
    try:
        for number in range(len(jobs)):
            while number not in done:  # results of others may wait in memory
                begun = max(0, min(at_once - len(running), 2 * at_once - len(done)))
                for n, (work, path) in islice(waiting, begun):
                    try:
                        if not (idle and idle[-1].worker.is_alive):
                            idle.append(_Reader(work, limits))
                        reader = idle.pop()
                        reader.begin(work, path)
                        running[n] = reader
                    except (OSError, WorkerDied) as error:  # no memory for another, perhaps
                        done[n] = BagError(f"{path} got no process to be read in: {error}.")
                for n in _ended(running):
                    reader = running.pop(n)
                    answer = done[n] = reader.answer()
                    if isinstance(answer, OracleError):
                        reader.worker.end()
                    else:
                        idle.append(reader)
            yield done.pop(number)
    finally:
        for reader in (*running.values(), *idle):
            reader.worker.end()


class _Reader:
    """A worker that reads one recording at a time, within limits."""

    def __init__(self, first: Callable[[Path], object], limits: Limits) -> None:
        context = _context(getattr(first, "func", first).__module__)
        self.worker, self._limits = Worker(context, _prepare), limits

    def begin(self, work: Callable[[Path], object], path: Path) -> None:
        """Give it a recording."""
        self.deadline_s = time.monotonic() + self._limits.seconds
        self._path = path
        self.worker.begin(_within, work, path, self._limits)

    def answer(self) -> Any:
        """Return its answer, or an error if there is none by now."""
        if not self.worker.pipe.poll():
            return BagError(
                f"{self._path} took longer than the limit of {self._limits.seconds:g} s; "
                f"{self._limits.advice('--time-limit')}."
            )
        try:
            return self.worker.answer()
        except WorkerDied as death:
            return BagError(
                f"The process that read {self._path} died ({_exit_reason(death.exit_code)}); "
                "perhaps it ran out of memory. Please report the file."
            )


def _ended(running: Mapping[int, _Reader]) -> list[int]:
    """Wait for a process that answers, dies or exceeds its time; return the numbers of these."""
    first_s = min((each.deadline_s for each in running.values()), default=0.0)
    wait_s = max(0.0, first_s - time.monotonic())
    pipes = {n: each.worker.pipe for n, each in running.items()}
    ready, now_s = connection.wait(pipes.values(), wait_s), time.monotonic()
    return [n for n, pipe in pipes.items() if pipe in ready or now_s >= running[n].deadline_s]


def _prepare() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it without a traceback
    os.environ.pop(FOLDER_VARIABLE, None)  # the server may have an outdated value


def _within(work: Callable[[Path], object], path: Path, limits: Limits) -> object:
    """Return what a function returns for a recording, or an error, in the other process."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    size = _memory() + int(limits.gibibytes * _GIB)
    resource.setrlimit(resource.RLIMIT_DATA, (size, hard))
    return _answer(work, path, limits)


@np.errstate(all="ignore")  # recordings hold NaN, infinity and what overflows
def _answer(work: Callable[[Path], Any], path: Path, limits: Limits) -> Any:
    try:
        return work(path)
    except MemoryError:
        return BagError(
            f"{path} needs more memory than the limit of {limits.gibibytes:g} GiB; "
            f"{limits.advice('--memory-limit')}."
        )
    except (OracleError, OSError) as error:
        return BagError(str(error))
    except Exception as error:  # a bug of ours must not end the suite
        return BagError(f"{path} cannot be read: {type(error).__name__}: {error}")


def _memory() -> int:
    """Return the bytes that this process has taken over, as its limit counts them."""
    table = Path("/proc/self/statm")
    return int(table.read_text().split()[5]) * resource.getpagesize() if table.exists() else 0


def _context(module: str) -> ForkContext | ForkServerContext:
    """Return how a process begins that needs a module: as a fork of this one, or of a server.

    This process may only be forked while no other thread of it can hold a lock.
    """
    if sys.platform != "linux" or len(sys._current_frames()) > 1:  # of all threads
        return _server(module)
    return multiprocessing.get_context("fork")


@cache
def _server(module: str) -> ForkServerContext:
    """Return the context; its server, if it does not run yet, imports what the module needs."""
    context = multiprocessing.get_context("forkserver")
    first = [FINDS_OURS] if FINDS_OURS in sys.modules else []  # as it is in this process
    context.set_forkserver_preload([*first, module])
    return context


def _exit_reason(code: int | None) -> str:
    if code is not None and code < 0:
        return signal.Signals(-code).name
    return f"exit code {code}"
