"""Managed nodes, the managers that start them in order, and the bonds between them.

Services here answer with plain values: their messages never reach a topic, so no bag holds them.
"""

import enum
import uuid
from collections.abc import Sequence

import numpy as np

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header

_BondStatus = message_class("bond/msg/Status")
_DiagnosticArray = message_class("diagnostic_msgs/msg/DiagnosticArray")
_DiagnosticStatus = message_class("diagnostic_msgs/msg/DiagnosticStatus")
_State = message_class("lifecycle_msgs/msg/State")
_Transition = message_class("lifecycle_msgs/msg/Transition")
_TransitionEvent = message_class("lifecycle_msgs/msg/TransitionEvent")

HEARTBEAT_NS = 100 * MILLISECOND
BOND_TIMEOUT_S = 4.0
_RETRY_NS = 100 * MILLISECOND
_BOND_PUBLISHER = qos.profile(5)
_BOND_SUBSCRIPTION = qos.profile(100)


class State(enum.IntEnum):
    """States of ``lifecycle_msgs/msg/State``."""

    UNCONFIGURED = 1
    INACTIVE = 2
    ACTIVE = 3
    CONFIGURING = 10
    ACTIVATING = 13


class _Request(enum.IntEnum):
    """Transitions of ``lifecycle_msgs/msg/Transition`` that a manager requests."""

    CONFIGURE = 1
    ACTIVATE = 3


class _Bond:
    """One end of a bond: sends a heartbeat to the other end ten times a second."""

    def __init__(self, node: Node, bond_id: str) -> None:
        self._node = node
        self._publisher = node.create_publisher("bond/msg/Status", "/bond", _BOND_PUBLISHER)
        node.create_subscription("bond/msg/Status", "/bond", None, _BOND_SUBSCRIPTION)
        instance = str(uuid.uuid5(uuid.NAMESPACE_URL, f"{node.name}/{bond_id}"))
        status = _BondStatus(
            header(0, ""), bond_id, instance, True, BOND_TIMEOUT_S, HEARTBEAT_NS / SECOND
        )
        self._status = Template(status, "bond/msg/Status", STAMP)  # only the stamp changes
        node.create_timer(HEARTBEAT_NS, self._beat, phase_ns=0)

    def _beat(self) -> None:
        self._publisher.publish_serialized(self._status.data(*self._node.stamp))


class LifecycleNode(Node):
    """A node that a manager configures and activates.

    Parameters
    ----------
    domain, name, rng, latency_ns
        As for `Node`.
    bond
        Whether the node sends heartbeats on ``/bond`` once active; costmap nodes do not.
    """

    def __init__(
        self,
        domain: Domain,
        name: str,
        *,
        bond: bool = True,
        rng: np.random.Generator | None = None,
        latency_ns: int = 0,
    ) -> None:
        super().__init__(domain, name, rng=rng, latency_ns=latency_ns)
        self.state = State.UNCONFIGURED
        self._bonded = bond
        self._events = self.create_publisher(
            "lifecycle_msgs/msg/TransitionEvent", f"{name}/transition_event"
        )
        self.create_service("lifecycle_msgs/srv/ChangeState", f"{name}/change_state", self._change)
        for service, srvtype in (
            ("get_state", "GetState"),
            ("get_available_states", "GetAvailableStates"),
            ("get_available_transitions", "GetAvailableTransitions"),
            ("get_transition_graph", "GetAvailableTransitions"),
        ):
            self.create_service(f"lifecycle_msgs/srv/{srvtype}", f"{name}/{service}", nothing)

    @property
    def is_active(self) -> bool:
        """Return whether the node is active."""
        return self.state is State.ACTIVE

    def is_ready(self) -> bool:
        """Return whether the node can be activated; Nav2's costmaps wait for transforms here."""
        return True

    def on_configure(self) -> None:
        """Make what the node needs before it is active."""

    def on_activate(self) -> None:
        """Start work."""

    def configure(self) -> None:
        """Go from unconfigured to inactive."""
        self._enter(State.CONFIGURING)
        self.on_configure()
        self._enter(State.INACTIVE)

    def activate(self) -> bool:
        """Go from inactive to active; False, to be called again, while the node is not ready."""
        if self.state is State.INACTIVE:
            self._enter(State.ACTIVATING)
        if not self.is_ready():
            return False
        self.on_activate()
        self._enter(State.ACTIVE)
        if self._bonded:
            _Bond(self, self.name.lstrip("/"))
        return True

    def _enter(self, state: State) -> None:
        # rcl fills in the two states only, never stamp and transition.
        event = _TransitionEvent(
            0, _Transition(0, ""), _state_message(self.state), _state_message(state)
        )
        self.state = state
        self._events.publish(event)

    def _change(self, transition: _Request) -> bool:
        if transition is _Request.CONFIGURE:
            self.configure()
            return True
        return self.activate()


class LifecycleManager(Node):
    """Brings nodes up: configures all in order, then activates all in order.

    Parameters
    ----------
    domain, name
        As for `Node`.
    managed
        Full names of the nodes in the order of bring-up; they may appear later.
    """

    def __init__(self, domain: Domain, name: str, managed: Sequence[str]) -> None:
        super().__init__(domain, name)
        self.is_active = False
        self._diagnostics = self.create_publisher(
            "diagnostic_msgs/msg/DiagnosticArray", "/diagnostics", qos.profile(1)
        )
        self.create_service("nav2_msgs/srv/ManageLifecycleNodes", f"{name}/manage_nodes", nothing)
        self.create_service("std_srvs/srv/Trigger", f"{name}/is_active", nothing)
        self._clients = {node: self.create_client(f"{node}/change_state") for node in managed}
        for node in managed:
            self.create_client(f"{node}/get_state")
        self._todo = [(step, node) for step in _Request for node in managed]
        self.create_timer(SECOND, self._diagnose)
        self.call_later(0, self._next)

    def _next(self) -> None:
        """Request the next transition, or finish."""
        if not self._todo:
            self.is_active = True
            self.info("Managed nodes are active")
            return
        step, node = self._todo[0]
        self._clients[node].call(step, self._answered)

    def _answered(self, success: bool) -> None:
        if not success:
            self.call_later(_RETRY_NS, self._next)
            return
        step, node = self._todo.pop(0)
        if step is _Request.ACTIVATE:
            _Bond(self, node.lstrip("/"))
            self.info(f"Server {node.lstrip('/')} connected with bond.")
        self._next()

    def _diagnose(self) -> None:
        level, text = (0, "Nav2 is active") if self.is_active else (2, "Nav2 is inactive")
        status = _DiagnosticStatus(level, f"{self.name[1:]}: Nav2 Health", text, "", [])
        self._diagnostics.publish(_DiagnosticArray(header(self.now_ns, ""), [status]))


def _state_message(state: State) -> object:
    return _State(int(state), state.name.lower())


def nothing(_request: object) -> None:
    """Answer a service that exists, as in Nav2, but has no client here."""
