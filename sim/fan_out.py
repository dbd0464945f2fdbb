"""Many independent jobs over one ``concurrent.futures`` executor, each failing alone.

A job that raises becomes an outcome with the error's text. A worker process that dies breaks its
whole pool; the jobs it took along are tried once more in a new one, so only the job that kills
its worker twice is lost.
"""

import multiprocessing
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Generic, TypeVar

from oracle_pipeline.bags.errors import OracleError

J = TypeVar("J")
R = TypeVar("R")

_ATTEMPTS = 2


@dataclass(frozen=True, slots=True)
class Outcome(Generic[J, R]):
    """What became of one job: a result, or the text of the error that ended it."""

    job: J
    result: R | None = None
    error: str | None = None


def process_pool(workers: int) -> ProcessPoolExecutor:
    """Return a pool of fresh interpreters: nothing leaks in from the parent."""
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


def fan_out(
    function: Callable[[J], R], jobs: Sequence[J], make_executor: Callable[[], Executor]
) -> Iterator[Outcome[J, R]]:
    """Yield the outcome of every job, as they finish.

    Parameters
    ----------
    function
        Module-level function of one job; it and the jobs must be picklable for a process pool.
    jobs
        In the order in which they start.
    make_executor
        Gives an executor to run them on, and another one if that breaks.
    """
    attempts = [0] * len(jobs)
    waiting = list(range(len(jobs)))
    while waiting:
        with make_executor() as executor:
            futures = {executor.submit(function, jobs[i]): i for i in waiting}
            waiting = []
            for future in as_completed(futures):
                index = futures[future]
                outcome = _outcome(jobs[index], future)
                if outcome is None:
                    attempts[index] += 1
                    if attempts[index] < _ATTEMPTS:
                        waiting.append(index)
                        continue
                    outcome = Outcome(jobs[index], error="its worker process died, twice")
                yield outcome
        waiting.sort()


def _outcome(job: J, future: Future[R]) -> Outcome[J, R] | None:
    """Return a finished job's outcome, or None if its pool broke under it."""
    error = future.exception()
    if error is None:
        return Outcome(job, result=future.result())
    if isinstance(error, BrokenExecutor):
        return None
    if isinstance(error, OracleError):  # says what, where and what to do; no need of a traceback
        return Outcome(job, error=str(error))
    return Outcome(job, error="".join(traceback.format_exception(error)))
