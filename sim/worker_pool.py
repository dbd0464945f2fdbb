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
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import partial
from typing import Any, Self, TypeVar

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.processes import FINDS_OURS
from oracle_pipeline.bags.worker import Worker

R = TypeVar("R")

LIMIT = "ORACLE_JOB_TIMEOUT"  # environment variable [s]
DEFAULT_LIMIT_S = 3600.0  # a run of ten simulated minutes takes less than one


class JobTimeoutError(OracleError):
    """A job exceeded its time limit, and its worker was ended."""

    @classmethod
    def after(cls, limit_s: float) -> Self:
        """Return the error for a limit."""
        return cls(
            f"It exceeded the limit of {limit_s:g} s, so its worker was ended. If it needs longer, "
            f"increase {LIMIT}."
        )


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
        self._workers: list[Worker] = []

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        """Give a job to the next free worker; function, arguments and result must be picklable."""
        return super().submit(self._do, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers after the jobs that have begun."""
        super().shutdown(wait, cancel_futures=cancel_futures)
        for worker in self._workers if wait else ():
            worker.dismiss()

    def _do(self, fn: Callable[..., R], args: Any, kwargs: Any) -> R:
        worker: Worker | None = getattr(self._of_thread, "worker", None)
        if worker is None or not worker.is_alive:
            worker = self._of_thread.worker = _worker(_module_of(fn))
            self._workers.append(worker)
        worker.begin(fn, *args, **kwargs)
        if not worker.pipe.poll(self._limit_s):
            worker.end()
            raise JobTimeoutError.after(self._limit_s)
        result: R = worker.answer()
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


def _worker(module: str) -> Worker:
    """Start a worker; the fork server imports a module if it is not running yet."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([FINDS_OURS, module])
    return Worker(context, _prepare, dict(os.environ))


def _module_of(function: Callable[..., Any]) -> str:
    """Return the name of the module that a job's function is in."""
    while isinstance(function, partial):
        function = function.func
    return function.__module__


def _prepare(environment: Mapping[str, str]) -> None:
    """Take over the caller's environment: the fork server has that of its own start."""
    os.environ.clear()
    os.environ.update(environment)
    _end_with_caller()


def _end_with_caller() -> None:
    """End this worker with its caller, even during a job."""
    caller = multiprocessing.parent_process()

    def watch() -> None:
        if caller is not None:
            caller.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
