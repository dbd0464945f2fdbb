"""Nav2's actions by name: their types, clients and servers."""

from collections.abc import Callable, Iterable

from sim.middleware.action import ActionClient, ActionServer, GoalHandle
from sim.middleware.node import Node


def action_type(name: str) -> str:
    """Return the type of an action: ``nav2_msgs/action/FollowPath`` of ``follow_path``."""
    words = "BackUp" if name == "backup" else name.title().replace("_", "")
    return f"nav2_msgs/action/{words}"


def client(node: Node, name: str) -> ActionClient:
    """Return a client of an action."""
    return ActionClient(node, action_type(name), f"/{name}")


def leave_unserved(node: Node, names: Iterable[str]) -> None:
    """Offer actions that exist, as in Nav2, but have no client here: goals are aborted."""
    for name in names:
        ActionServer(node, action_type(name), f"/{name}", GoalHandle.abort)


class SimpleActionServer(ActionServer):
    """Nav2's server of an action: a goal runs, and the latest one waits to take its place.

    Parameters
    ----------
    node, name
        The serving node, and the action's name.
    start
        Called when a goal is to run and none does.
    wake
        Called when a goal waits, or is to be cancelled.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        start: Callable[[], None],
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(node, action_type(name), f"/{name}", self._take, self._cancel)
        self._start_goal = start
        self._wake = wake
        self._accepted: list[GoalHandle] = []  # the running one and the one to take its place

    @property
    def current(self) -> GoalHandle:
        """The running goal."""
        return self._accepted[0]

    @property
    def is_preempted(self) -> bool:
        """Whether another goal waits."""
        return len(self._accepted) > 1

    def accept_pending(self) -> None:
        """Let the goal that waits run instead of the current one."""
        self._accepted.pop(0).abort()

    def end(self, answer: Callable[[GoalHandle], None]) -> None:
        """End the running goal with an answer, and start the one that waits."""
        answer(self._accepted.pop(0))
        if self._accepted:
            self._start_goal()

    def _take(self, goal: GoalHandle) -> None:
        for replaced in self._accepted[1:]:
            replaced.abort()
        self._accepted[1:] = [goal]
        if self._accepted == [goal]:
            self._start_goal()
        else:
            self._wake()

    def _cancel(self, goal: GoalHandle) -> None:
        if goal in self._accepted:
            self._wake()
