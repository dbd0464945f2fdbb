"""Lets the UI execute runs again that were started on the command line.

Dagster records the code location of a run only if the UI or the daemon has started it, and
`Re-execute` needs it (https://github.com/dagster-io/dagster/issues/19458).
"""

import dagster as dg

from resources.dagster_internals import (
    RegisteredCodeLocationOrigin,
    RemoteJobOrigin,
    RemoteRepositoryOrigin,
)

LOCATION = "oracle"  # as in workspace.yaml
_REPOSITORY = "__repository__"  # Dagster's name for that of a ``Definitions``


def record_origin(instance: dg.DagsterInstance, run_id: str) -> None:
    """Record that a run's job belongs to our code location, unless a location is recorded."""
    run = instance.get_run_by_id(run_id)
    if run is None or run.remote_job_origin is not None:
        return
    location = RegisteredCodeLocationOrigin(LOCATION)
    job = RemoteJobOrigin(RemoteRepositoryOrigin(location, _REPOSITORY), run.job_name)
    instance.run_storage.replace_job_origin(run, job)
