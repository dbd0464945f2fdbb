"""A worker: a process that does one job after another, and whose death costs one job only.

Jobs and results go through a pipe of its own, so a worker that dies or hangs affects no other.
"""

import pickle
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from multiprocessing.connection import Connection
from multiprocessing.context import ForkContext, ForkServerContext
from multiprocessing.reduction import ForkingPickler
from typing import Any, TypeAlias

from oracle_pipeline.bags.processes import collect_rarely, no_program

Context: TypeAlias = ForkContext | ForkServerContext

_END_TIMEOUT_S = 10.0  # of an idle worker
_STARTING = threading.Lock()  # while a process is started, this one has no program


class WorkerDied(BrokenExecutor):
    """A worker ended before its job did; `exit_code` is that of its process."""

    def __init__(self, exit_code: int | None) -> None:
        super().__init__("its worker process died")
        self.exit_code = exit_code


class Worker:
    """A process, and the pipe to it.

    Parameters
    ----------
    context : Context
        How the process begins.
    prepare : callable
        Called in the process, before its first job.
    *arguments
        Of `prepare`.

    Attributes
    ----------
    pipe : Connection
        Can be read once there is an answer, or the process has ended.
    """

    def __init__(self, context: Context, prepare: Callable[..., None], *arguments: Any) -> None:
        self.pipe, theirs = context.Pipe()
        given = (theirs, prepare, arguments)
        self._process = context.Process(target=_work, args=given, daemon=True)
        with _STARTING, no_program():
            self._process.start()
        theirs.close()  # so that the pipe closes when the process ends

    @property
    def is_alive(self) -> bool:
        """Whether it can take a job; its pipe ends before a server of forks knows of its death."""
        return self._process.is_alive() and not self.pipe.poll()

    def begin(self, function: Callable[..., Any], *arguments: Any, **named: Any) -> None:
        """Give it a job; function, arguments and result must be picklable.

        Raises
        ------
        WorkerDied
            If the process has ended.
        """
        try:
            job = ForkingPickler.dumps((function, arguments, named), pickle.HIGHEST_PROTOCOL)
            self.pipe.send_bytes(job)  # `send` pickles by an older protocol, with one more copy
        except ConnectionError as error:
            raise self._death() from error

    def answer(self) -> Any:
        """Wait for a job's result and return it, or raise what the job raised.

        Raises
        ------
        WorkerDied
            If the process ended before.
        """
        try:
            is_done, result = self.pipe.recv()
        except (EOFError, ConnectionError) as error:
            raise self._death() from error
        if is_done:
            return result
        raise result

    def dismiss(self) -> None:
        """End it when it is idle."""
        self.pipe.close()
        self._process.join(_END_TIMEOUT_S)
        self.end()

    def end(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.join()
        self.pipe.close()

    def _death(self) -> WorkerDied:
        self.dismiss()
        return WorkerDied(self._process.exitcode)


def _work(pipe: Connection, prepare: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Do jobs until the pipe is closed."""
    collect_rarely()
    prepare(*arguments)
    while True:
        try:
            function, given, named = pipe.recv()
        except (EOFError, OSError, KeyboardInterrupt):
            return
        except BaseException as error:  # an error while unpickling is a failure of the job
            answer = False, _portable(error)
        else:
            answer = _answer(function, given, named)
            del function, given, named  # they may be large
        try:
            pipe.send(answer)
        except OSError:
            return
        except Exception as error:  # a result that cannot be pickled
            pipe.send((False, _portable(error)))


def _answer(function: Callable[..., Any], given: Any, named: Any) -> tuple[bool, Any]:
    try:
        return True, function(*given, **named)
    except BaseException as error:
        return False, _portable(error)


def _portable(error: BaseException) -> BaseException:
    """Return a picklable error, with its traceback in a note."""
    text = "".join(traceback.format_exception(error))
    error.add_note(f"In the worker:\n{text}")
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301 -- pickled in this line
    except Exception:
        return RuntimeError(text)
    return error
