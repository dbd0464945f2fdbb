"""Who does the work of many runs: here, processes of this machine."""

import os
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import dagster as dg
from pydantic import Field

from sim.fan_out import Outcome, fan_out, process_pool

J = TypeVar("J")
R = TypeVar("R")


class Fleet(dg.ConfigurableResource[None]):
    """Worker processes, each a fresh interpreter; what they run imports no Dagster."""

    workers: int = Field(
        default=os.cpu_count() or 1, ge=1, description="Runs that are worked on at a time."
    )

    def outcomes(self, function: Callable[[J], R], jobs: Sequence[J]) -> Iterator[Outcome[J, R]]:
        """Yield what became of every job, as they finish; one that fails fails alone.

        Parameters
        ----------
        function
            Module-level function of one job.
        jobs
            In the order in which they start.
        """
        return fan_out(function, jobs, lambda: process_pool(min(self.workers, len(jobs))))
