"""One ROS domain: the graph of nodes, publishers and subscriptions, and delivery.

Introspection answers what ``ros2 node list`` and ``ros2 node info`` answer. Endpoints are made
through ``node``; delivery is in ``endpoints``.
"""

import functools
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from rosbags.interfaces import Qos

from oracle_pipeline.bags.qos_profiles import compatible, is_latched
from sim.middleware.delays import Delays
from sim.middleware.endpoints import Publisher, Sample, Subscription
from sim.middleware.executor import Executor
from sim.middleware.node_parameters import NodeParameter

_Endpoint = TypeVar("_Endpoint")


@dataclass(slots=True, eq=False)
class Service:
    """A service or an action of one node, which other nodes may call."""

    node: str
    name: str
    type: str
    handler: Any  # the function of a service, the server of an action


class Offer(NamedTuple):
    """A service or an action: its name and type, the node that offers it, and its clients."""

    name: str
    type: str
    server: str
    clients: list[str]


class Domain:
    """All nodes that can discover each other, as with one ``ROS_DOMAIN_ID``.

    Parameters
    ----------
    executor
        Simulated time.
    delays
        Delays added to the latency of a node, by its name; None: nothing. A node without latency
        receives everything at once.
    """

    def __init__(
        self, executor: Executor, delays: Callable[[str], Delays | None] = lambda _: None
    ) -> None:
        self.executor = executor
        self._delays = functools.cache(delays)  # all subscriptions of a node share them
        self.revision = 0  # counts publishers: unchanged if there is no new one
        self.topics: dict[str, str] = {}  # name -> message type, in order of appearance
        self.parameters: dict[tuple[str, str], NodeParameter] = {}  # by node and name
        self._publishers: dict[str, list[Publisher]] = {}  # by topic
        self._subscriptions: dict[str, list[Subscription]] = {}  # by topic
        self._nodes: dict[str, None] = {}
        self._services: dict[str, Service] = {}
        self._clients: list[tuple[str, str, str]] = []  # node, service, type
        self._actions: dict[str, Service] = {}  # by action
        self._action_clients: list[tuple[str, str, str]] = []  # node, action, type

    # -- making endpoints (called by Node) -------------------------------------------------

    def add_node(self, name: str) -> None:
        """Register a node by its full name."""
        if name in self._nodes:
            raise ValueError(f"node {name} exists already; choose another name")
        self._nodes[name] = None

    def add_publisher(self, node: str, msgtype: str, topic: str, qos: Qos) -> Publisher:
        """Connect a new publisher to the subscriptions that fit."""
        self._declare(topic, msgtype)
        retained = deque[Sample](maxlen=qos.depth) if is_latched(qos) else None
        publisher = Publisher(self.executor, node, topic, msgtype, qos, retained=retained)
        self._publishers[topic].append(publisher)
        self.revision += 1
        for subscription in self._subscriptions[topic]:
            if compatible(qos, subscription.qos):
                publisher.connect(subscription)
        return publisher

    def add_subscription(self, subscription: Subscription) -> None:
        """Connect a new subscription; latched samples arrive at once."""
        if subscription.latency_ns:
            subscription.delays = self._delays(subscription.node)
        self._declare(subscription.topic, subscription.msgtype)
        self._subscriptions[subscription.topic].append(subscription)
        for publisher in self._publishers[subscription.topic]:
            if compatible(publisher.qos, subscription.qos):
                publisher.connect(subscription)

    def add_service(self, service: Service) -> None:
        """Register a service by its full name."""
        if service.name in self._services:
            raise ValueError(f"service {service.name} is offered twice")
        self._services[service.name] = service

    def add_client(self, node: str, name: str, srvtype: str) -> None:
        """Register a node as a client of a service."""
        self._clients.append((node, name, srvtype))

    def add_action_server(self, action: Service) -> None:
        """Register the server of an action."""
        self._actions[action.name] = action

    def add_action_client(self, node: str, name: str, action_type: str) -> None:
        """Register a node as a client of an action."""
        self._action_clients.append((node, name, action_type))

    def add_parameter(self, parameter: NodeParameter) -> None:
        """Register a parameter that others may set."""
        self.parameters[parameter.node, parameter.name] = parameter

    def service(self, name: str) -> Service:
        """Return an existing service."""
        try:
            return self._services[name]
        except KeyError:
            raise LookupError(f"no node offers the service {name}") from None

    def action_server(self, name: str) -> Any:
        """Return the server of an existing action."""
        try:
            return self._actions[name].handler
        except KeyError:
            raise LookupError(f"no node serves the action {name}") from None

    def _declare(self, topic: str, msgtype: str) -> None:
        declared = self.topics.setdefault(topic, msgtype)
        if declared != msgtype:
            raise TypeError(f"topic {topic} is {declared}; it cannot also be {msgtype}")
        self._publishers.setdefault(topic, [])
        self._subscriptions.setdefault(topic, [])

    # -- introspection ---------------------------------------------------------------------

    def node_names(self) -> list[str]:
        """Return the full name of every node, as ``ros2 node list`` does."""
        return sorted(self._nodes)

    def publishers(self, topic: str | None = None) -> Iterator[Publisher]:
        """Yield the publishers of one topic, or of all."""
        yield from _endpoints(self._publishers, topic)

    def subscriptions(self, topic: str | None = None) -> Iterator[Subscription]:
        """Yield the subscriptions of one topic, or of all."""
        yield from _endpoints(self._subscriptions, topic)

    def services(self) -> Iterator[Offer]:
        """Yield the services of all nodes, those of actions included."""
        return _offers(self._services, self._clients)

    def actions(self) -> Iterator[Offer]:
        """Yield the actions of all nodes."""
        return _offers(self._actions, self._action_clients)


def _offers(
    offered: Mapping[str, Service], clients: Sequence[tuple[str, str, str]]
) -> Iterator[Offer]:
    for each in offered.values():
        its = [node for node, name, _ in clients if name == each.name]
        yield Offer(each.name, each.type, each.node, its)


def _endpoints(by_topic: Mapping[str, list[_Endpoint]], topic: str | None) -> Iterator[_Endpoint]:
    if topic is not None:
        yield from by_topic.get(topic, [])
        return
    for endpoints in by_topic.values():
        yield from endpoints
