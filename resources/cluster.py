"""A Dask cluster as an executor of ``concurrent.futures``. No Dagster here; needs the extra `dask`.

The cluster is somebody else's: it is started and stopped elsewhere (docs/scaling.md). A job is
a function that workers import and one argument, so a worker needs this package and no Dagster.
"""

import itertools
import secrets
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, TypeVar

from distributed import Client, KilledWorker

from oracle_pipeline.bags.errors import OracleError

R = TypeVar("R")

PATIENCE_S = 60  # for the first worker to come

__all__ = ["ClusterError", "DaskExecutor", "KilledWorker"]


class ClusterError(OracleError):
    """Nobody answers, or nobody works there."""


class DaskExecutor(Executor):
    """The workers of the cluster whose scheduler is at an address, such as ``tcp://host:8786``.

    Raises
    ------
    ClusterError
        No scheduler answers there, or it has no worker.
    """

    def __init__(self, address: str) -> None:
        try:
            self._client = Client(address, timeout=PATIENCE_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterError(
                f"No Dask scheduler answers at {address!r}: {error}. Start one, correct "
                "ORACLE_DASK, or unset it to work on this machine."
            ) from error
        try:
            self._client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError as error:
            self._client.close()
            raise ClusterError(
                f"The Dask scheduler at {address} has no workers; start some with "
                f"`dask worker {address} --nthreads 1`."
            ) from error
        self._executor = self._client.get_executor()
        # A key of its own, for equal calls are each done; and keys of one group: the scheduler then
        # keeps what no worker is free for instead of dealing all out, so that a worker that dies
        # takes few jobs with it.
        self._group, self._numbers = secrets.token_hex(8), itertools.count()

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        """Hand a call to the cluster."""
        key = (f"{getattr(fn, '__name__', 'job')}-{self._group}", next(self._numbers))
        future: Future[R] = self._executor.submit(fn, *args, key=key, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster; what has not started by then never will."""
        self._executor.shutdown(wait=wait and not cancel_futures)
        self._client.close()
