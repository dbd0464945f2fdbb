"""Who does the work of many runs: processes of this machine, or a Dask cluster."""

import os
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import dagster as dg
from pydantic import Field

from resources.failures import clear_failures
from sim.fan_out import Outcome, fan_out, process_pool

J = TypeVar("J")
R = TypeVar("R")

NEWS = 10  # times that a step tells of its progress


class Fleet(dg.ConfigurableResource[None]):
    """Worker processes, each a fresh interpreter; what they run imports no Dagster."""

    workers: int = Field(
        default=os.cpu_count() or 1,
        ge=1,
        description="Runs that are worked on at a time on this machine; a cluster has its own.",
    )
    # No part of a run's config: whoever starts a run must not choose whom this process connects to.
    address: dg.ResourceDependency[str] = Field(
        default="",  # type: ignore[arg-type]  # Dagster makes a dependency of it
        description="Scheduler of a Dask cluster to work on, such as `tcp://host:8786`; "
        "empty: this machine.",
    )

    def outcomes(self, function: Callable[[J], R], jobs: Sequence[J]) -> Iterator[Outcome[J, R]]:
        """Yield what became of every job, as they finish; one that fails fails alone.

        Progress and failures go to the log of the Dagster run.

        Parameters
        ----------
        function
            Module-level function of one job.
        jobs
            In the order in which they start.

        Raises
        ------
        dagster.Failure
            Nobody answers at the address, or nobody works there.
        """
        log = dg.get_dagster_logger()
        failed = 0
        with clear_failures():
            for done, outcome in enumerate(self._fan_out(function, jobs), start=1):
                if outcome.error is not None:
                    failed += 1
                    log.warning(f"{outcome.job} failed: {outcome.error}")
                if done * NEWS // len(jobs) > (done - 1) * NEWS // len(jobs):
                    log.info(f"{done} of {len(jobs)} jobs are over, {failed} of them failed.")
                yield outcome

    def _fan_out(self, function: Callable[[J], R], jobs: Sequence[J]) -> Iterator[Outcome[J, R]]:
        if not self.address:
            return fan_out(function, jobs, lambda: process_pool(min(self.workers, len(jobs))))
        from resources.cluster import DaskExecutor

        return fan_out(function, jobs, lambda: DaskExecutor(self.address))
