"""The executor of all jobs: Dagster's in-process executor, which registers its process."""

from collections.abc import Iterator

import dagster as dg

from resources.dagster_internals import ExecutionPlan, PlanOrchestrationContext, RetryMode
from resources.run_origin import record_origin
from resources.run_processes import fail_lost_runs, hold


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
        record_origin(plan_context.instance, plan_context.run_id)
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
