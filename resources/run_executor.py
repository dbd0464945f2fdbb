"""The executor of all jobs: Dagster's in-process executor, which registers its process."""

from collections.abc import Iterator

import dagster as dg

from resources.dagster_internals import (
    ExecutionPlan,
    PlanOrchestrationContext,
    RegisteredCodeLocationOrigin,
    RemoteJobOrigin,
    RemoteRepositoryOrigin,
    RetryMode,
)
from resources.run_processes import fail_lost_runs, hold

LOCATION = "oracle"  # as in workspace.yaml
_REPOSITORY = "__repository__"  # Dagster's name for that of a ``Definitions``


class _RegisteredProcessExecutor(dg.Executor):
    """Executes all steps in this process, and registers it so that a killed run is detected."""

    def __init__(self, steps: dg.Executor) -> None:
        self._steps = steps

    @property
    def retries(self) -> RetryMode:
        return self._steps.retries

    def execute(
        self, plan_context: PlanOrchestrationContext, execution_plan: ExecutionPlan
    ) -> Iterator[dg.DagsterEvent]:
        hold(plan_context.instance, plan_context.run_id)
        _record_origin(plan_context.instance, plan_context.run_id)
        fail_lost_runs(plan_context.instance)
        yield from self._steps.execute(plan_context, execution_plan)


@dg.executor(name="in_process")
def in_process_executor(context: dg.InitExecutorContext) -> dg.Executor:
    """Execute a run in one process: assets fan out themselves."""
    settings = dg.InitExecutorContext(
        job=context.job,
        executor_def=dg.in_process_executor,
        executor_config={"retries": {"enabled": {}}},
        instance=context.instance,
    )
    create = dg.in_process_executor.executor_creation_fn
    assert create is not None  # noqa: S101 -- an executor that Dagster ships
    return _RegisteredProcessExecutor(create(settings))


def _record_origin(instance: dg.DagsterInstance, run_id: str) -> None:
    """Record that a run's job belongs to our code location, unless a location is recorded.

    Dagster records it only if the UI or the daemon has started the run, and `Re-execute` needs it
    (https://github.com/dagster-io/dagster/issues/19458).
    """
    run = instance.get_run_by_id(run_id)
    if run is None or run.remote_job_origin is not None:
        return
    location = RegisteredCodeLocationOrigin(LOCATION)
    job = RemoteJobOrigin(RemoteRepositoryOrigin(location, _REPOSITORY), run.job_name)
    instance.run_storage.replace_job_origin(run, job)
