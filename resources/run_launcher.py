"""The run launcher of our Dagster instances: the default one, with a health check.

Dagster's monitoring daemon uses it to detect runs whose process has died.
"""

import dagster as dg

from resources.dagster_internals import CheckRunHealthResult, WorkerStatus
from resources.run_processes import reason_of_loss


class WatchedRunLauncher(dg.DefaultRunLauncher):
    """Starts runs at the code server, and detects runs on this machine whose process has died."""

    @property
    def supports_check_run_worker_health(self) -> bool:
        """Whether the monitoring daemon should check the health of runs."""
        return True

    def check_run_worker_health(self, run: dg.DagsterRun) -> CheckRunHealthResult:
        """Return whether the process of a run is alive, whichever program started it."""
        if reason := reason_of_loss(self._instance, run.run_id):
            return CheckRunHealthResult(WorkerStatus.FAILED, reason)
        return CheckRunHealthResult(WorkerStatus.RUNNING)
