"""The workers for many runs: processes of this machine, or a Dask cluster."""

import itertools
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from typing import TypeVar, cast

import dagster as dg
from pydantic import Field, PrivateAttr

from resources.failures import clear_failures
from sim.fan_out import JobOutcome, fan_out, process_pool
from sim.worker_pool import LentPool, WorkerPool

J = TypeVar("J")
R = TypeVar("R")

PROGRESS_S = 10.0  # between two log lines on the progress of a step
_FEWEST = 3  # finished jobs to estimate the remaining time from: the first one may compile


class Fleet(dg.ConfigurableResource[None]):
    """Worker processes, each a fresh interpreter. Their code imports no Dagster.

    All steps of a Dagster run share them, so that imports happen once.
    """

    workers: int = Field(
        default=os.cpu_count() or 1,
        ge=1,
        description="Number of parallel worker processes on this machine; unused with a cluster.",
    )
    # Not part of the run config: a run request must not choose what this process connects to.
    address: dg.ResourceDependency[str] = Field(
        default="",  # type: ignore[arg-type]  # Dagster makes a dependency of it
        description="Scheduler of a Dask cluster to work on, such as `tcp://host:8786`; "
        "empty: this machine.",
    )
    _pool: WorkerPool | None = PrivateAttr(default=None)  # of a Dagster run, created on first use
    _shares_pool: bool = PrivateAttr(default=False)

    def setup_for_execution(self, context: dg.InitResourceContext) -> None:  # noqa: ARG002
        """Share the workers until the run ends."""
        self._shares_pool = True

    def teardown_after_execution(self, context: dg.InitResourceContext) -> None:  # noqa: ARG002
        """End the workers."""
        if self._pool is not None:
            self._pool.shutdown()

    def outcomes(
        self, function: Callable[[J], R], jobs: Sequence[J], done: str = "jobs done"
    ) -> Iterator[JobOutcome[J, R]]:
        """Yield the outcome of each job when it finishes; a failure does not affect other jobs.

        Progress and failures are logged to the Dagster run.

        Parameters
        ----------
        function
            Module-level function of one job.
        jobs
            In the order in which they start.
        done
            Name of finished jobs in the log.

        Raises
        ------
        dagster.Failure
            The scheduler does not answer, or has no workers.
        """
        log = dg.get_dagster_logger()
        failed, started, logged = 0, time.monotonic(), time.monotonic()
        with clear_failures():
            for over, outcome in enumerate(self._fan_out(function, jobs), start=1):
                if outcome.error is not None:
                    failed += 1
                    log.warning(f"{outcome.job} failed: {outcome.error}")
                now = time.monotonic()
                if over == len(jobs) or now - logged >= PROGRESS_S:
                    logged = now
                    log.info(_progress(over, len(jobs), done, failed, now - started))
                yield outcome

    def results(
        self, function: Callable[[J], R], jobs: Sequence[J], done: str = "jobs done"
    ) -> list[R]:
        """Return the result of each job, in their order.

        Parameters are those of `outcomes`.

        Raises
        ------
        dagster.Failure
            A job failed; as `outcomes`.
        """
        found: dict[J, R] = {}
        for outcome in self.outcomes(function, jobs, done):
            if outcome.error is not None:
                raise dg.Failure(f"{outcome.job}: {outcome.error}", allow_retries=False)
            found[outcome.job] = cast(R, outcome.result)
        return [found[job] for job in jobs]

    def _fan_out(self, function: Callable[[J], R], jobs: Sequence[J]) -> Iterator[JobOutcome[J, R]]:
        if not self.address:
            return fan_out(function, jobs, self._workers)
        from resources import cluster

        patience = itertools.chain([cluster.PATIENCE_S], itertools.repeat(cluster.LOST_S))
        return fan_out(function, jobs, lambda: cluster.DaskExecutor(self.address, next(patience)))

    def _workers(self) -> Executor:
        """Return the local worker processes."""
        if not self._shares_pool:
            return process_pool(self.workers)
        if self._pool is None:
            self._pool = process_pool(self.workers)
        return LentPool(self._pool)


def _progress(over: int, jobs: int, done: str, failed: int, seconds: float) -> str:
    """Return a sentence on the progress of a step, with the remaining time.

    Examples
    --------
    >>> _progress(6, 18, "runs done", 1, 60.4)
    '6 of 18 runs done in 60 s, 1 failed; about 2 min to go.'
    >>> _progress(18, 18, "runs done", 0, 181.0)
    '18 of 18 runs done in 3 min, none failed.'
    """
    rest = ""
    if _FEWEST <= over < jobs:
        rest = f"; about {in_words(seconds / over * (jobs - over))} to go"
    return f"{over} of {jobs} {done} in {in_words(seconds)}, {failed or 'none'} failed{rest}."


def in_words(seconds: float) -> str:
    """Return a duration as text in seconds, minutes or hours.

    Examples
    --------
    >>> [in_words(seconds) for seconds in (12.3, 449.0, 9000.0)]
    ['12 s', '7 min', '2.5 h']
    """
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
