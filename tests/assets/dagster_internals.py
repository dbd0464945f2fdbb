"""Names of Dagster's that are not public and that only tests need, in one place."""

from dagster._core.definitions.freshness_evaluator import TimeWindowFreshnessPolicyEvaluator
from dagster._core.loader import LoadingContextForTest
from dagster._core.test_utils import freeze_time
from dagster._core.workspace.context import WorkspaceProcessContext
from dagster._core.workspace.load_target import WorkspaceFileTarget

__all__ = [
    "LoadingContextForTest",
    "TimeWindowFreshnessPolicyEvaluator",
    "WorkspaceFileTarget",
    "WorkspaceProcessContext",
    "freeze_time",
]
