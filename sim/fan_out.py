"""Runs many independent jobs on ``concurrent.futures`` executors; each fails alone.

A job that raises an error or takes too long becomes an outcome with the text of the error. If a
worker dies (on a cluster, with other jobs), the lost jobs are run once more together, then one by
one. So only a job that kills its worker on its own is given up.
"""

import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from dataclasses import dataclass
from typing import Generic, TypeVar

from oracle_pipeline.bags.errors import OracleError
from sim.worker_pool import WorkerPool, limit_from_environment

J = TypeVar("J")
R = TypeVar("R")

_ROUNDS_TOGETHER = 2


@dataclass(frozen=True, slots=True)
class JobOutcome(Generic[J, R]):
    """The outcome of one job: a result, or the text of the error that ended it."""

    job: J
    result: R | None = None
    error: str | None = None


def process_pool(workers: int) -> WorkerPool:
    """Return an executor of fresh interpreters, with the job timeout of the environment."""
    return WorkerPool(workers, limit_from_environment())


def fan_out(
    function: Callable[[J], R], jobs: Sequence[J], make_executor: Callable[[], Executor]
) -> Iterator[JobOutcome[J, R]]:
    """Yield the outcome of every job, as they finish.

    Parameters
    ----------
    function
        Module-level function of one job; it and the jobs must be picklable for a process pool.
    jobs
        In the order in which they start.
    make_executor
        Creates an executor for the jobs, and a new one if that breaks.
    """
    unfinished = list(jobs)
    for _ in range(_ROUNDS_TOGETHER):
        if unfinished:
            unfinished = yield from _together(function, unfinished, make_executor)
    for job in unfinished:
        for killer in (yield from _together(function, [job], make_executor)):
            yield JobOutcome(killer, error="its worker process died; is there enough memory?")


def _together(
    function: Callable[[J], R], jobs: Sequence[J], make_executor: Callable[[], Executor]
) -> Generator[JobOutcome[J, R], None, list[J]]:
    """Yield the outcomes of jobs in one executor; return those whose worker died."""
    unfinished: list[int] = []
    futures: dict[Future[R], int] = {}
    executor = make_executor()
    try:
        for index, job in enumerate(jobs):
            try:
                futures[executor.submit(function, job)] = index
            except BrokenExecutor:
                unfinished.append(index)
        for future in as_completed(futures):
            index = futures.pop(future)  # frees its result: there may be thousands
            outcome = _outcome(jobs[index], future)
            if outcome is None:
                unfinished.append(index)
            else:
                yield outcome
    finally:  # also when the consumer stops early: cancel jobs that have not started
        executor.shutdown(cancel_futures=True)
    return [jobs[index] for index in sorted(unfinished)]


def _outcome(job: J, future: Future[R]) -> JobOutcome[J, R] | None:
    """Return a finished job's outcome, or None if its worker died."""
    error = future.exception()
    if error is None:
        return JobOutcome(job, result=future.result())
    if isinstance(error, BrokenExecutor):
        return None
    if isinstance(error, OracleError):  # its text is enough, without a traceback
        return JobOutcome(job, error=str(error))
    return JobOutcome(job, error="".join(traceback.format_exception(error)))
