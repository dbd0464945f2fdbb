"""Actions: long tasks with feedback, result, cancellation, and their hidden topics.

As in ROS 2, an action has two hidden topics (``_action/feedback``, ``_action/status``) and three
hidden services; the goal's state machine is that of ``action_msgs/msg/GoalStatus``.
"""

import enum
import uuid
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Service
from sim.middleware.node import Node
from sim.middleware.stamps import time_message

_UUID = message_class("unique_identifier_msgs/msg/UUID")
_GoalInfo = message_class("action_msgs/msg/GoalInfo")
_GoalStatus = message_class("action_msgs/msg/GoalStatus")
_GoalStatusArray = message_class("action_msgs/msg/GoalStatusArray")


class GoalStatus(enum.IntEnum):
    """Goal states of ``action_msgs/msg/GoalStatus``."""

    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def is_terminal(self) -> bool:
        """Return whether the goal has ended."""
        return self >= GoalStatus.SUCCEEDED


class GoalHandle:
    """One goal, as the server and its client see it."""

    def __init__(
        self, server: "ActionServer", goal: Any, goal_id: bytes, client: "_Callbacks"
    ) -> None:
        self.goal = goal
        self.goal_id = goal_id
        self.accepted_ns = server.node.now_ns
        self.status = GoalStatus.ACCEPTED
        self._server = server
        self._client = client

    @property
    def is_active(self) -> bool:
        """Return whether the goal still runs."""
        return not self.status.is_terminal

    def publish_feedback(self, feedback: Any) -> None:
        """Send feedback to the client and to the hidden feedback topic."""
        self._server.publish_feedback(self, feedback)
        self._server.node.call_later(0, self._client.feedback, feedback)

    def execute(self) -> None:
        """Start work on an accepted goal."""
        self._set(GoalStatus.EXECUTING)

    def succeed(self, result: Any = None) -> None:
        """End with success."""
        self._end(GoalStatus.SUCCEEDED, result)

    def abort(self, result: Any = None) -> None:
        """End with failure: the goal cannot be reached."""
        self._end(GoalStatus.ABORTED, result)

    def canceled(self, result: Any = None) -> None:
        """End because a client requested it."""
        self._end(GoalStatus.CANCELED, result)

    def cancel(self) -> None:
        """Request the server to stop; the client's side of the handle."""
        if self.status is GoalStatus.ACCEPTED:  # not started, so there is nothing to stop
            self.canceled()
        elif self.status is GoalStatus.EXECUTING:
            self._set(GoalStatus.CANCELING)
            self._server.node.call_later(0, self._server.on_cancel, self)

    def _end(self, status: GoalStatus, result: Any) -> None:
        self._set(status)
        self._server.node.call_later(0, self._client.result, status, result)

    def _set(self, status: GoalStatus) -> None:
        if self.status.is_terminal:
            raise RuntimeError(f"goal of {self._server.name} is {self.status.name} already")
        self.status = status
        self._server.publish_status()


class _Callbacks(NamedTuple):
    """Callbacks of a client about one goal."""

    feedback: Callable[[Any], None]
    result: Callable[[GoalStatus, Any], None]


class ActionServer:
    """The server of an action.

    Parameters
    ----------
    node, action_type, name
        The serving node, the type (``nav2_msgs/action/Spin``) and the full name (``/spin``).
    on_goal
        Called with the handle of each new goal, when it is executing. A server that runs one
        goal at a time ends the one before itself.
    on_cancel
        Called when a client requests to stop; calls ``handle.canceled()``, now or later.
        A server with a loop needs none: it reads the handle's status.
    """

    def __init__(
        self,
        node: Node,
        action_type: str,
        name: str,
        on_goal: Callable[[GoalHandle], None],
        on_cancel: Callable[[GoalHandle], None] = lambda _: None,
    ) -> None:
        self.node = node
        self.name = name
        self.on_cancel = on_cancel
        self._on_goal = on_goal
        self._goals: list[GoalHandle] = []
        self._feedback_type = message_class(f"{action_type}_FeedbackMessage")
        self._feedback = node.create_publisher(
            f"{action_type}_FeedbackMessage", f"{name}/_action/feedback", qos.DEFAULT
        )
        self._status = node.create_publisher(
            "action_msgs/msg/GoalStatusArray", f"{name}/_action/status", qos.LATCHED
        )
        node.domain.actions.add(Service(node.name, name, action_type, self))
        for service, kind in (("send_goal", "SendGoal"), ("get_result", "GetResult")):
            node.create_service(f"{action_type}_{kind}", f"{name}/_action/{service}", self._direct)
        node.create_service(
            "action_msgs/srv/CancelGoal", f"{name}/_action/cancel_goal", self._direct
        )

    def accept(self, goal: Any, goal_id: bytes, client: _Callbacks) -> GoalHandle:
        """Accept a goal; its execution starts at the same time, after the caller has returned."""
        handle = GoalHandle(self, goal, goal_id, client)
        self._goals = [*[g for g in self._goals if g.is_active][-1:], handle]
        self.publish_status()
        self.node.call_later(self.node.latency_ns, self._start, handle)
        return handle

    @property
    def feedback_is_received(self) -> bool:
        """Return whether a subscriber uses the hidden feedback topic."""
        return self._feedback.has_receiver()

    def publish_feedback(self, handle: GoalHandle, feedback: Any) -> None:
        """Publish on the hidden feedback topic if it has a subscriber."""
        if self.feedback_is_received:
            self._feedback.publish(self._feedback_type(_uuid(handle.goal_id), feedback))

    def publish_status(self) -> None:
        """Publish the state of the goals on the hidden status topic."""
        self._status.publish(
            _GoalStatusArray(
                [
                    _GoalStatus(
                        _GoalInfo(_uuid(g.goal_id), time_message(g.accepted_ns)), int(g.status)
                    )
                    for g in self._goals
                ]
            )
        )

    def _start(self, handle: GoalHandle) -> None:
        if handle.status is GoalStatus.ACCEPTED:
            handle.execute()
            self._on_goal(handle)

    @staticmethod
    def _direct(_request: Any) -> None:
        """Reject a call: the hidden service exists only in the graph, as goals use ``accept``."""


class ActionClient:
    """A node's client of an action."""

    def __init__(self, node: Node, action_type: str, name: str) -> None:
        self._node = node
        self._name = name
        self._sent = 0
        feedback_type = f"{action_type}_FeedbackMessage"
        node.create_subscription(feedback_type, f"{name}/_action/feedback", None)
        node.create_subscription(
            "action_msgs/msg/GoalStatusArray", f"{name}/_action/status", None, qos.LATCHED
        )
        node.domain.actions.add_client(node.name, name)

    def send_goal(
        self,
        goal: Any,
        on_result: Callable[[GoalStatus, Any], None],
        on_feedback: Callable[[Any], None] = lambda _: None,
    ) -> GoalHandle:
        """Send a goal and return its handle, accepted.

        Raises
        ------
        LookupError
            If no node offers the action.
        """
        self._sent += 1
        # The goal id depends only on the client, the action and the number of former goals.
        goal_id = uuid.uuid5(uuid.NAMESPACE_URL, f"{self._node.name}{self._name}#{self._sent}")
        server: ActionServer = self._node.domain.actions[self._name].handler
        return server.accept(goal, goal_id.bytes, _Callbacks(on_feedback, on_result))


def _uuid(goal_id: bytes) -> Any:
    return _UUID(np.frombuffer(goal_id, dtype=np.uint8))
