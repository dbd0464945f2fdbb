"""The leaves of Nav2's navigation tree: conditions, calls of services, and actions."""

from collections.abc import Callable
from typing import Any

from sim.middleware.action import ActionClient, GoalHandle, GoalStatus
from sim.middleware.node import Client
from sim.nav2.behavior_tree import NodeStatus, TreeNode


class Condition(TreeNode):
    """Succeeds if a condition holds."""

    def __init__(self, name: str, holds: Callable[[], bool]) -> None:
        super().__init__(name)
        self._holds = holds

    def tick(self) -> NodeStatus:
        """Test the condition."""
        return NodeStatus.SUCCESS if self._holds() else NodeStatus.FAILURE


class ServiceNode(TreeNode):
    """Calls a service and succeeds when it has answered.

    Parameters
    ----------
    name, client
        Name in the log, and the client of the service.
    on_start
        Called with every request.
    wake
        Requests a tick of the tree, as soon as there is an answer.
    """

    def __init__(
        self, name: str, client: Client, on_start: Callable[[], None], wake: Callable[[], None]
    ) -> None:
        super().__init__(name)
        self._client = client
        self._on_start = on_start
        self._wake = wake
        self._answered = False

    def tick(self) -> NodeStatus:
        """Call the service, or check for its answer."""
        if self.status is NodeStatus.IDLE:
            self._answered = False
            self._on_start()
            self._client.call(None, self._on_answer)
            return NodeStatus.RUNNING
        return NodeStatus.SUCCESS if self._answered else NodeStatus.RUNNING

    def _on_answer(self, _response: Any) -> None:
        self._answered = True
        self._wake()


class ActionNode(TreeNode):
    """Sends a goal to an action, and waits for its result.

    Parameters
    ----------
    name, client
        Name in the log, and the client of the action.
    make_goal
        Called for the goal at the start, and in every later tick: a new object is sent as a new
        goal, in place of the running one.
    wake
        Requests a tick of the tree, as soon as there is a result.
    on_start
        Called when the action starts.
    on_success
        Called with the result of a goal that was reached.
    """

    def __init__(
        self, name: str, client: ActionClient, make_goal: Callable[[], Any],
        wake: Callable[[], None], *, on_start: Callable[[], None] = lambda: None,
        on_success: Callable[[Any], None] = lambda _: None,
    ) -> None:  # fmt: skip
        super().__init__(name)
        self._client = client
        self._make_goal = make_goal
        self._wake = wake
        self._on_start = on_start
        self._on_success = on_success
        self._goal: Any = None
        self._handle: GoalHandle | None = None
        self._result: tuple[GoalStatus, Any] | None = None

    def tick(self) -> NodeStatus:
        """Send the goal, or check for its result."""
        if self.status is NodeStatus.IDLE:
            self._on_start()
            self._goal = None
            self._result = None
        if self._result is None:
            goal = self._make_goal()
            if goal is not self._goal:
                self._send(goal)
            return NodeStatus.RUNNING
        status, result = self._result
        self._handle = None
        if status is GoalStatus.SUCCEEDED:
            self._on_success(result)
        return NodeStatus.FAILURE if status is GoalStatus.ABORTED else NodeStatus.SUCCESS

    def halt(self) -> None:
        """Cancel the goal."""
        if self._handle is not None and self._handle.is_active:
            self._handle.cancel()
        self._handle = None
        super().halt()

    def _send(self, goal: Any) -> None:
        self._goal = goal

        def on_result(status: GoalStatus, result: Any) -> None:
            if self._handle is handle:  # not that of a goal that was replaced or given up
                self._result = (status, result)
                self._wake()

        handle = self._handle = self._client.send_goal(goal, on_result)
