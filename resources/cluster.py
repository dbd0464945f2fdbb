"""A Dask cluster as an executor of ``concurrent.futures``. No Dagster here; needs the extra `dask`.

You start and stop the cluster yourself (docs/how-to/scaling.md). A job is a function that workers
import and one argument, so a worker needs this package and no Dagster.
"""

import concurrent.futures
import itertools
import logging
import os
import secrets
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import distributed

from oracle_pipeline.bags.errors import OracleError
from sim.worker_pool import JobTimeoutError, limit_from_environment

R = TypeVar("R")

PATIENCE_S = 60  # timeout for the scheduler, and for the first worker
LOST_S = 600  # the same, once they were there: until they are started again
LAST_WORDS_S = 2.0  # in which a worker that is about to end reports why

_LOG = logging.getLogger("distributed.worker")  # of a worker; its settings are Dask's


class ClusterError(OracleError):
    """No scheduler answers at the address, or it has no workers."""


class WorkerLost(BrokenExecutor):
    """A worker died, or the scheduler became unreachable, before the result arrived."""


class DaskExecutor(Executor):
    """The workers of the cluster whose scheduler is at an address, such as ``tcp://host:8786``.

    The executor of `distributed` itself waits indefinitely for a result whose worker or scheduler
    disappeared at the wrong moment. Here, each loss of a result ends its future with an error.

    Parameters
    ----------
    address : str
    patience_s : float
        Timeout for the scheduler, and for its first worker.

    Raises
    ------
    ClusterError
        No scheduler answers there, or it has no worker.
    """

    def __init__(self, address: str, patience_s: float) -> None:
        try:
            self._client = distributed.Client(address, timeout=patience_s, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterError(
                f"No Dask scheduler answers at {address!r}: {error}. Start one, correct "
                "ORACLE_DASK, or unset it to work on this machine."
            ) from error
        try:
            self._client.wait_for_workers(1, timeout=patience_s)
        except TimeoutError as error:
            self._client.close()
            raise ClusterError(
                f"The Dask scheduler at {address} has no workers; start some with "
                f"`dask worker {address} --nthreads 1`."
            ) from error
        # Unique keys, so that equal calls are all executed, of one group, so that the scheduler
        # queues jobs until a worker is free. A worker that dies then takes few jobs with it.
        self._group, self._numbers = secrets.token_hex(8), itertools.count()
        self._limit_s = limit_from_environment()
        # Keep references: the cluster drops results without any.
        self._remote: dict[Future[Any], distributed.Future[Any]] = {}

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        """Submit a call to the cluster."""
        key = (f"{getattr(fn, '__name__', 'job')}-{self._group}", next(self._numbers))
        local: Future[R] = Future()
        remote = self._client.submit(_in_time, self._limit_s, fn, *args, key=key, **kwargs)
        self._remote[local] = remote
        local.set_running_or_notify_cancel()
        remote.add_done_callback(partial(self._resolve, local))
        return local

    def _resolve(self, local: Future[R], remote: "distributed.Future[R]") -> None:
        """Resolve our future with the outcome of the cluster's future."""
        try:
            local.set_result(remote.result(timeout=PATIENCE_S))
        except (distributed.KilledWorker, CancelledError, OSError) as error:
            raised_remotely = remote.status == "error" and isinstance(error, OSError)
            local.set_exception(error if raised_remotely else WorkerLost(str(error)))
        except BaseException as error:
            local.set_exception(error)
        finally:
            del self._remote[local]

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Disconnect from the cluster; by option, cancel jobs that have not started."""
        if wait and not cancel_futures:
            concurrent.futures.wait(list(self._remote))
        self._client.close()


def _in_time(limit_s: float, function: Callable[..., R], *args: Any, **kwargs: Any) -> R:
    """Call a function on a worker, and log it with its arguments.

    No thread can be stopped, so a worker whose job exceeds its time limit ends. Its nanny, or
    Kubernetes, starts another one.
    """
    job = ", ".join(map(str, args))
    _LOG.info("Begin: %s", job)
    pool = ThreadPoolExecutor(1)
    future = pool.submit(function, *args, **kwargs)
    pool.shutdown(wait=False)
    if not concurrent.futures.wait([future], limit_s).done:
        _LOG.error("Exceeded the limit of %g s: %s", limit_s, job)
        threading.Timer(LAST_WORDS_S, os._exit, [1]).start()
        raise JobTimeoutError.after(limit_s)
    _LOG.info("End: %s", job)
    return future.result()
