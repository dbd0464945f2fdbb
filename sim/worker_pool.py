"""A pool of worker processes that names the job which killed its worker or hangs.

``ProcessPoolExecutor`` breaks as a whole when one worker dies, and waits indefinitely for one that
hangs. Here each worker has one job at a time and a separate pipe, so the loss of one does not
affect the others.

Workers are forked from one fresh interpreter, the fork server of ``multiprocessing``. It imports
the modules of the first job, which takes more than a second; a fork takes milliseconds.
"""

import concurrent.futures
import multiprocessing
import os
import pickle
import threading
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Self, TypeVar

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.processes import FINDS_OURS, no_program

R = TypeVar("R")

LIMIT = "ORACLE_JOB_TIMEOUT"  # environment variable [s]
DEFAULT_LIMIT_S = 3600.0  # a run of ten simulated minutes takes less than one

_END_TIMEOUT_S = 10.0  # of an idle worker


class JobTimeoutError(OracleError):
    """A job exceeded its time limit, and its worker was ended."""

    @classmethod
    def after(cls, limit_s: float) -> Self:
        """Return the error for a limit."""
        return cls(
            f"It exceeded the limit of {limit_s:g} s, so its worker was ended. If it needs longer, "
            f"increase {LIMIT}."
        )


class WorkerDied(BrokenExecutor):
    """A worker ended before its job did."""


def limit_from_environment() -> float:
    """Return the time limit of a job [s]: ``ORACLE_JOB_TIMEOUT``, or an hour.

    Raises
    ------
    OracleError
        If it is not a number above 0.
    """
    text = os.environ.get(LIMIT) or str(DEFAULT_LIMIT_S)
    try:
        limit_s = float(text)
    except ValueError:
        limit_s = 0.0
    if not limit_s > 0.0:
        raise OracleError(f"{LIMIT} is {text!r}; give the time limit of a job in seconds, above 0.")
    return limit_s


class WorkerPool(ThreadPoolExecutor):
    """An executor of forks of a fresh interpreter: nothing leaks in from the parent.

    Parameters
    ----------
    workers
        Largest number of workers; each is started with its first job.
    limit_s
        Time limit of a job [s]; after that its worker is ended and replaced.
    """

    def __init__(self, workers: int, limit_s: float) -> None:
        super().__init__(workers)
        self._limit_s = limit_s
        self._of_thread = threading.local()
        self._starting = threading.Lock()
        self._workers: list[_Worker] = []

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        """Give a job to the next free worker; function, arguments and result must be picklable."""
        return super().submit(self._do, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers after the jobs that have begun."""
        super().shutdown(wait, cancel_futures=cancel_futures)
        for worker in self._workers if wait else ():
            worker.dismiss()

    def _do(self, fn: Callable[..., R], args: Any, kwargs: Any) -> R:
        worker: _Worker | None = getattr(self._of_thread, "worker", None)
        if worker is None or not worker.is_alive:
            with self._starting:
                worker = self._of_thread.worker = _Worker(_module_of(fn))
                self._workers.append(worker)
        result: R = worker.do((fn, args, kwargs), self._limit_s)
        return result


class LentPool(Executor):
    """A view of a pool for one of several uses; its shutdown keeps the workers running.

    Parameters
    ----------
    pool
        Its creator ends the workers.
    """

    def __init__(self, pool: WorkerPool) -> None:
        self._pool = pool
        self._futures: list[Future[Any]] = []

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        """Submit a job to the next free worker of the pool."""
        future = self._pool.submit(fn, *args, **kwargs)
        self._futures.append(future)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the jobs of this use that have begun."""
        for future in self._futures if cancel_futures else ():
            future.cancel()
        if wait:
            concurrent.futures.wait(self._futures)


class _Worker:
    """One process, and the pipe to it.

    Parameters
    ----------
    module
        Module that the fork server imports if it is not running yet.
    """

    def __init__(self, module: str) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([FINDS_OURS, module])
        self._pipe, theirs = context.Pipe()
        arguments = (theirs, dict(os.environ))  # the fork server has those of its own start
        self._process = context.Process(target=_work, args=arguments, daemon=True)
        with no_program():
            self._process.start()
        theirs.close()

    @property
    def is_alive(self) -> bool:
        """Whether it can take a job."""
        return self._process.is_alive()

    def do(self, job: Any, limit_s: float) -> Any:
        """Return a job's result, or raise what it raised."""
        try:
            self._pipe.send(job)
            if not self._pipe.poll(limit_s):
                self._end()
                raise JobTimeoutError.after(limit_s)
            is_done, result = self._pipe.recv()
        except (EOFError, ConnectionError) as error:
            self._end()
            raise WorkerDied("its worker process died") from error
        if is_done:
            return result
        raise result

    def dismiss(self) -> None:
        """End it when it is idle."""
        self._pipe.close()
        self._process.join(_END_TIMEOUT_S)
        self._end()

    def _end(self) -> None:
        self._process.kill()
        self._process.join()


def _module_of(function: Callable[..., Any]) -> str:
    """Return the name of the module that a job's function is in."""
    while isinstance(function, partial):
        function = function.func
    return function.__module__


def _work(pipe: Connection, environment: Mapping[str, str]) -> None:
    """Do jobs until the pipe is closed."""
    os.environ.clear()
    os.environ.update(environment)
    _end_with_caller()
    while True:
        try:
            function, args, kwargs = pipe.recv()
        except (EOFError, OSError, KeyboardInterrupt):
            return
        except BaseException as error:  # an error while unpickling is a failure of the job
            answer = False, _portable(error)
        else:
            answer = _answer(function, args, kwargs)
        try:
            pipe.send(answer)
        except OSError:
            return
        except Exception as error:  # a result that cannot be pickled
            pipe.send((False, _portable(error)))


def _answer(function: Callable[..., Any], args: Any, kwargs: Any) -> tuple[bool, Any]:
    try:
        return True, function(*args, **kwargs)
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


def _end_with_caller() -> None:
    """End this worker with its caller, even during a job."""
    caller = multiprocessing.parent_process()

    def watch() -> None:
        if caller is not None:
            caller.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
