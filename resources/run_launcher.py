"""The run launcher of our Dagster instances: the default one, with a health check.

Dagster's monitoring daemon asks it whether the process of a run still exists. The default launcher
cannot tell.
"""

import dagster as dg

from resources.dagster_internals import CheckRunHealthResult, WorkerStatus
from resources.run_processes import reason_of_loss


class WatchedRunLauncher(dg.DefaultRunLauncher):
    """Start runs at the code server, and detect runs on this machine whose process has died."""

    @property
    def supports_check_run_worker_health(self) -> bool:
        """Whether the monitoring daemon is to ask."""
        return True

    def check_run_worker_health(self, run: dg.DagsterRun) -> CheckRunHealthResult:
        """Tell whether the process of a run has died, whichever program started it."""
        if reason := reason_of_loss(self._instance, run.run_id):
            return CheckRunHealthResult(WorkerStatus.FAILED, reason)
        return CheckRunHealthResult(WorkerStatus.RUNNING)
