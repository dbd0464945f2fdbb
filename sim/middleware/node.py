"""The node, with an interface like that of rclpy, for a robot's software.

A node turns messages into messages. Each one has its own generator for randomness and its own
processing latency; it never sees the world.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.interfaces import Qos

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos as profiles
from sim.middleware.domain import Domain, Service
from sim.middleware.endpoints import Publisher, Subscription
from sim.middleware.executor import SECOND, Timer
from sim.middleware.node_parameters import EVENT, NodeParameter
from sim.middleware.stamps import time_message

_Log = message_class("rcl_interfaces/msg/Log")

_PARAMETER_SERVICES = {
    "describe_parameters": "rcl_interfaces/srv/DescribeParameters",
    "get_parameter_types": "rcl_interfaces/srv/GetParameterTypes",
    "get_parameters": "rcl_interfaces/srv/GetParameters",
    "list_parameters": "rcl_interfaces/srv/ListParameters",
    "set_parameters": "rcl_interfaces/srv/SetParameters",
    "set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
}


class Node:
    """A node of the ROS graph.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    name
        Full name, with a leading ``/`` and the namespace.
    endpoints
        Implicit endpoints by the letters of the graph sheet: ``C`` subscribes ``/clock``, ``P``
        publishes ``/parameter_events`` (and offers the parameter services), ``E`` subscribes
        ``/parameter_events``. Every node publishes ``/rosout``.
    rng
        The node's only source of randomness; nodes that draw nothing need none.
    latency_ns
        Time between a sample's publication and this node's callback.
    """

    def __init__(
        self,
        domain: Domain,
        name: str,
        *,
        endpoints: str = "CPE",
        rng: np.random.Generator | None = None,
        latency_ns: int = 0,
    ) -> None:
        domain.add_node(name)
        self.domain = domain
        self.name = name
        self.latency_ns = latency_ns
        self._rng = rng
        self._rosout = self.create_publisher("rcl_interfaces/msg/Log", "/rosout", profiles.ROSOUT)
        self._parameter_events: Publisher | None = None
        if "P" in endpoints:
            self._parameter_events = self.create_publisher(
                EVENT, "/parameter_events", profiles.PARAMETER_EVENTS
            )
            for service, srvtype in _PARAMETER_SERVICES.items():
                self.create_service(srvtype, f"{name}/{service}", _no_parameters)
        if "E" in endpoints:
            self.create_subscription(EVENT, "/parameter_events", None, profiles.PARAMETER_EVENTS)
        if "C" in endpoints:
            self.create_subscription("rosgraph_msgs/msg/Clock", "/clock", None, profiles.CLOCK)

    @property
    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self.domain.executor.now_ns

    @property
    def stamp(self) -> tuple[int, int]:
        """Simulated time as a message has it: seconds, and nanoseconds of the next."""
        return divmod(self.domain.executor.now_ns, SECOND)

    @property
    def rng(self) -> np.random.Generator:
        """The node's own generator."""
        if self._rng is None:
            raise ValueError(f"{self.name} draws random numbers but has no generator")
        return self._rng

    def create_publisher(self, msgtype: str, topic: str, qos: Qos = profiles.DEFAULT) -> Publisher:
        """Advertise a topic."""
        return self.domain.add_publisher(self.name, msgtype, topic, qos)

    def create_subscription(
        self,
        msgtype: str,
        topic: str,
        callback: Callable[[Any], None] | None,
        qos: Qos = profiles.DEFAULT,
        *,
        raw: bool = False,
    ) -> Subscription:
        """Subscribe to a topic; without a callback the endpoint only exists.

        With ``raw`` the callback gets CDR bytes instead of a message object, when they
        are sent; it must not publish.
        """
        subscription = Subscription(self.name, topic, msgtype, qos, callback, raw, self.latency_ns)
        self.domain.add_subscription(subscription)
        return subscription

    def create_timer(
        self, period_ns: int, callback: Callable[[], None], *, phase_ns: int | None = None
    ) -> Timer:
        """Call back every ``period_ns``, first after ``phase_ns`` (default: one period)."""
        first_ns = self.now_ns + (period_ns if phase_ns is None else phase_ns)
        return self.domain.executor.call_every(period_ns, callback, first_ns)

    def create_service(self, srvtype: str, name: str, handler: Callable[[Any], Any]) -> None:
        """Offer ``handler(request) -> response`` to other nodes."""
        self.domain.services.add(Service(self.name, name, srvtype, handler))

    def declare_parameter(
        self,
        name: str,
        value: float,
        checked: Callable[[float], float],
        changed: Callable[[float], None],
    ) -> None:
        """Let others set a parameter; see `NodeParameter`."""
        if self._parameter_events is None:
            raise ValueError(f"{self.name} was made without parameters")
        parameter = NodeParameter(self.name, name, value, checked, changed, self._parameter_events)
        self.domain.add_parameter(parameter)

    def create_client(self, name: str) -> "Client":
        """Return a client of a service."""
        self.domain.services.add_client(self.name, name)
        return Client(self, name)

    def call_later(self, delay_ns: int, callback: Callable[..., None], *arguments: Any) -> None:
        """Run ``callback`` once, ``delay_ns`` from now."""
        self.domain.executor.call_at(self.now_ns + delay_ns, callback, *arguments)

    def info(self, text: str) -> None:
        """Log to ``/rosout``."""
        self._log(20, text)

    def warn(self, text: str) -> None:
        """Log a warning to ``/rosout``."""
        self._log(30, text)

    def error(self, text: str) -> None:
        """Log an error to ``/rosout``."""
        self._log(40, text)

    def _log(self, level: int, text: str) -> None:
        logger = self.name.lstrip("/").replace("/", ".")
        stamp = time_message(self.now_ns)
        self._rosout.publish(_Log(stamp, level, logger, text, "", "", 0))


class Client:
    """A node's client of a service."""

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self._name = name

    def call(self, request: Any, done: Callable[[Any], None] = lambda _: None) -> None:
        """Send a request; ``done(response)`` runs when the answer arrives.

        Raises
        ------
        LookupError
            If no node offers the service.
        """
        service = self._node.domain.services[self._name]
        self._node.call_later(0, lambda: done(service.handler(request)))


def _no_parameters(_request: Any) -> None:
    """Return an empty answer: nodes here are configured when they are created."""
