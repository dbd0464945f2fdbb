"""Runs the work on recordings or cards in separate processes, with limits on time and memory.

If a recording crashes its process, the other recordings of a suite still get their verdicts.
Processes are forks, so that all modules are imported: of this process, or of a server if this one
has threads. A process takes one recording after another, until one fails.
"""

import importlib
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice
from multiprocessing import connection
from multiprocessing.context import ForkContext, ForkServerContext
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

from oracle_pipeline.bags.errors import BagError, OracleError
from oracle_pipeline.bags.merging import Messages
from oracle_pipeline.bags.processes import FINDS_OURS, no_program
from oracle_pipeline.bags.terminal import progress_bar
from oracle_pipeline.features import FeatureManager, FeatureTables, build_manager, extract
from oracle_pipeline.features.engine.kept_messages import KeptMessages
from oracle_pipeline.features.engine.timeline import Timeline
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
_WARM = "oracle_pipeline.features.warm_start"
_STARTING = threading.Lock()  # while a process is started, this one has no program


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
        return [
            _of_robot(str(path), run, robot, manager, reading)
            for robot in find_robots(run.bag, reading.choices, reading.known)
        ]


def _of_robot(
    path: str, run: OpenedRun, robot: Robot, manager: FeatureManager, reading: Reading
) -> Extracted:
    observer = Observer(robot.bag, paced=reading.paced)
    tables, clock, faults = _tables(run, robot, manager, observer, reading.check)
    seen = interfaces(observer, run, robot, clock)
    origin = origin_of(run, robot, starts=reading.paced)
    return Extracted(of_robot(path, robot.name), tables, seen, origin, faults)


def interfaces(observer: Observer, run: OpenedRun, robot: Robot, clock: Timeline) -> Observation:
    """Return what was observed of a robot's messages, with the roles of its topics."""
    roles = {role: found.topics for role, found in robot.roles.found.items() if found.topics}
    seen = observer.observation(run, clock)
    return replace(seen, roles=roles, instead=robot.instead)


def _tables(
    run: OpenedRun, robot: Robot, manager: FeatureManager, observer: Observer, check: Check | None
) -> tuple[FeatureTables, Timeline, Sequence[str]]:
    """Return the features of one robot, the clock of its recording, and its faults.

    What was kept of the messages is freed before the observation is made.
    """
    signals = SignalCollector(robot)

    def see(batch: Messages) -> None:
        observer.see(batch)
        signals.see(batch)

    recording = KeptMessages.read(robot, manager.plugins, see=see)
    tables = extract(run, manager, robot, recording, signals)
    faults = check(recording, signals) if check else ()
    return tables, recording.clock, faults


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
    """Yield what `run_isolated` returns or raises for each job in turn, a few at once."""
    at_once = min(os.cpu_count() or 1, MOST_AT_ONCE)
    waiting, running, done = enumerate(jobs), dict[int, _Process](), dict[int, T | OracleError]()
    idle: list[_Process] = []
    try:
        for number in range(len(jobs)):
            while number not in done:  # results of others may wait in memory
                begun = max(0, min(at_once - len(running), 2 * at_once - len(done)))
                for n, (work, path) in islice(waiting, begun):
                    try:
                        if not (idle and idle[-1].is_alive):
                            idle.append(_Process(work, limits, warm=len(jobs) > 1))
                        process = idle.pop()
                        process.begin(work, path)
                        running[n] = process
                    except OSError as error:  # no memory for a further process, perhaps
                        done[n] = BagError(f"{path} got no process to be read in: {error}.")
                for n in _ended(running):
                    process = running.pop(n)
                    answer = done[n] = process.answer()
                    if isinstance(answer, OracleError):
                        process.end()
                    else:
                        idle.append(process)
            yield done.pop(number)
    finally:
        for process in (*running.values(), *idle):
            process.end()


class _Process:
    """A process that works on one recording at a time, and the pipe to it."""

    def __init__(self, first: Callable[[Path], object], limits: Limits, *, warm: bool) -> None:
        context = _context(getattr(first, "func", first).__module__, warm=warm)
        self.pipe, theirs = context.Pipe()
        self._limits = limits
        self._process = context.Process(target=_work, args=(theirs, limits), daemon=True)
        with _STARTING, no_program():
            self._process.start()
        theirs.close()  # so that the pipe closes when the process ends

    @property
    def is_alive(self) -> bool:
        """Whether it can take a recording."""
        return self._process.is_alive()

    def begin(self, work: Callable[[Path], object], path: Path) -> None:
        """Give it a recording."""
        self.deadline_s = time.monotonic() + self._limits.seconds
        self._path = path
        self.pipe.send((work, path))

    def answer(self) -> Any:
        """Return its answer, or an error if there is none by now."""
        try:
            if self.pipe.poll():
                return self.pipe.recv()
            return BagError(
                f"{self._path} took longer than the limit of {self._limits.seconds:g} s; "
                f"{self._limits.advice('--time-limit')}."
            )
        except (EOFError, ConnectionError):
            self._process.join()
            return BagError(
                f"The process that read {self._path} died "
                f"({_exit_reason(self._process.exitcode)}); perhaps it ran out of memory. "
                "Please report the file."
            )

    def end(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.join()
        self.pipe.close()


def _ended(running: Mapping[int, _Process]) -> list[int]:
    """Wait for a process that answers, dies or exceeds its time; return the numbers of these."""
    first_s = min((each.deadline_s for each in running.values()), default=0.0)
    wait_s = max(0.0, first_s - time.monotonic())
    ready = connection.wait([each.pipe for each in running.values()], wait_s)
    now_s = time.monotonic()
    return [n for n, each in running.items() if each.pipe in ready or now_s >= each.deadline_s]


def _work(pipe: connection.Connection, limits: Limits) -> None:
    """Work in the other process on one recording after another, and send the results."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it without a traceback
    os.environ.pop(FOLDER_VARIABLE, None)  # the server may have an outdated value
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    with suppress(EOFError):  # when the one that began it ends
        while True:
            work, path = pipe.recv()
            size = _memory() + int(limits.gibibytes * _GIB)
            resource.setrlimit(resource.RLIMIT_DATA, (size, hard))
            pipe.send(_answer(work, path, limits))


def _answer(work: Callable[[Path], object], path: Path, limits: Limits) -> object:
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


def _context(module: str, *, warm: bool) -> ForkContext | ForkServerContext:
    """Return how a process begins that needs a module: as a fork of this one, or of a server.

    This process may only be forked while no other thread of it can hold a lock.
    """
    if sys.platform != "linux" or len(sys._current_frames()) > 1:  # of all threads
        return _server(module)
    if warm:
        importlib.import_module(_WARM)
    return multiprocessing.get_context("fork")


@cache
def _server(module: str) -> ForkServerContext:
    """Return the context; its server, if it does not run yet, imports what the module needs."""
    context = multiprocessing.get_context("forkserver")
    first = [FINDS_OURS] if FINDS_OURS in sys.modules else []  # as it is in this process
    context.set_forkserver_preload([*first, module, _WARM])
    return context


def _exit_reason(code: int | None) -> str:
    if code is not None and code < 0:
        return signal.Signals(-code).name
    return f"exit code {code}"
