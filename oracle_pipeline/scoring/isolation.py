"""Work on one recording in a separate process, within limits of time and memory.

If a recording kills its process, the others of a suite still get their verdicts. Processes are
forked from a server that has imported everything once.
"""

import multiprocessing
import os
import resource
import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from oracle_pipeline.bags.errors import BagError, OracleError
from oracle_pipeline.features import FeatureManager, FeatureTables, build_manager, extract
from oracle_pipeline.features.kept_messages import KeptMessages
from oracle_pipeline.features.manager import FOLDER_VARIABLE
from oracle_pipeline.opened_run import OpenedRun, open_run
from oracle_pipeline.robots.robot import Robot, find_robots, of_robot
from oracle_pipeline.robots.roles_file import RoleChoices
from oracle_pipeline.scoring.contract import Observation

T = TypeVar("T")

_GIB = 2**30


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits for the work on one recording."""

    seconds: float = 900.0
    gibibytes: float = 4.0  # of memory


DEFAULT_LIMITS = Limits()


class Extracted(NamedTuple):
    """The result of the other process for one robot."""

    recording: str  # its path, and which robot if there are several
    tables: FeatureTables
    observation: Observation
    has_manifest: bool


def extract_apart(
    path: Path,
    manager: FeatureManager,
    limits: Limits = DEFAULT_LIMITS,
    *,
    strict: bool = False,
    choices: RoleChoices | None = None,
    paced: bool = False,
) -> list[Extracted]:
    """Compute the features of a recording in another process.

    Parameters
    ----------
    path : Path
        A run directory or a bag.
    manager : FeatureManager
        As returned by `build_manager`; the process builds its own with the same plugins.
    limits : Limits
        Of that process.
    strict : bool
        Refuse an incomplete recording.
    choices : RoleChoices, optional
        What a roles file says of robots and topics.
    paced : bool
        Observe the paces of topics, too.

    Returns
    -------
    list of Extracted
        Of each robot the features, what the recording shows, and whether it has a manifest.

    Raises
    ------
    OracleError
        If the recording cannot be read, or its process died or went beyond the limits.
    """
    work = partial(extracted, plugins=manager.folder, strict=strict, choices=choices, paced=paced)
    return apart(work, path, limits)


def extracted(
    path: Path, plugins: Path | None, *, strict: bool, choices: RoleChoices | None, paced: bool
) -> list[Extracted]:
    """Compute the features of a recording in this process; otherwise as `extract_apart`."""
    with open_run(path, strict=strict) as run:
        manager = build_manager(plugins)
        return [
            _of_robot(str(path), run, robot, manager, paced=paced)
            for robot in find_robots(run.bag, choices)
        ]


def _of_robot(
    path: str, run: OpenedRun, robot: Robot, manager: FeatureManager, *, paced: bool
) -> Extracted:
    recording = KeptMessages.read(robot, manager.plugins)
    tables = extract(run, manager, robot, recording)
    length_s = (recording.duration_ns - 1) * 1e-9
    del recording  # its arrays, before the bag is read again
    seen = Observation.of(replace(run, bag=robot.bag), length_s, paced=paced)
    return Extracted(of_robot(path, robot.name), tables, seen, run.manifest is not None)


def apart(work: Callable[[Path], T], path: Path, limits: Limits = DEFAULT_LIMITS) -> T:
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
        If the function raised anything, or the process died or went beyond the limits.
    """
    receiver, sender = _context().Pipe(duplex=False)
    process = _context().Process(target=_work, args=(sender, work, path, limits), daemon=True)
    process.start()
    sender.close()  # so that the end of the process is the end of the pipe
    try:
        answer: T | OracleError = _received(receiver, process, path, limits)
    finally:
        process.kill()
        process.join()
        receiver.close()
    if isinstance(answer, OracleError):
        raise answer
    return answer


def _received(receiver: Connection, process: BaseProcess, path: Path, limits: Limits) -> Any:
    if not receiver.poll(limits.seconds):
        raise BagError(
            f"{path} took longer than {limits.seconds:g} s, the limit (--time-limit); raise it, "
            "or cut the recording into shorter ones."
        )
    try:
        return receiver.recv()
    except EOFError:
        process.join()
        raise BagError(
            f"The process that read {path} died ({_death(process.exitcode)}); perhaps there was "
            "not enough memory for it. Please report the recording."
        ) from None


def _work(sender: Connection, work: Callable[[Path], object], path: Path, limits: Limits) -> None:
    """Work in the other process, and send the result."""
    size = int(limits.gibibytes * _GIB)
    resource.setrlimit(resource.RLIMIT_DATA, (size, size))
    os.environ.pop(FOLDER_VARIABLE, None)  # the server may have an older one
    answer: object
    try:
        answer = work(path)
    except MemoryError:
        answer = BagError(
            f"{path} needs more than {limits.gibibytes:g} GiB of memory, the limit "
            "(--memory-limit); raise it, or cut the recording into shorter ones."
        )
    except (OracleError, OSError) as error:
        answer = BagError(str(error))
    except Exception as error:  # a defect of ours is one of this recording
        answer = BagError(f"{path} cannot be read: {type(error).__name__}: {error}")
    sender.send(answer)
    sender.close()


@cache
def _context() -> ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    return context


def _death(code: int | None) -> str:
    if code is not None and code < 0:
        return signal.Signals(-code).name
    return f"exit code {code}"
