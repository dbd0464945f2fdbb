"""One ROS domain: the graph of nodes, publishers and subscriptions, and delivery.

Introspection answers what ``ros2 node list`` and ``ros2 node info`` answer. Endpoints are made
through ``node``; delivery is in ``endpoints``.
"""

import functools
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

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


class Offers:
    """The services of all nodes, or their actions, and the nodes that call them.

    Parameters
    ----------
    kind
        ``service`` or ``action``.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._services: dict[str, Service] = {}
        self._clients: list[tuple[str, str]] = []  # node, and name of what it calls

    def add(self, service: Service) -> None:
        """Register a service by its full name."""
        if service.name in self._services:
            raise ValueError(f"{self._kind} {service.name} is offered twice")
        self._services[service.name] = service

    def add_client(self, node: str, name: str) -> None:
        """Register a node as a client; its service may appear later."""
        self._clients.append((node, name))

    def __getitem__(self, name: str) -> Service:
        try:
            return self._services[name]
        except KeyError:
            raise LookupError(f"no node offers the {self._kind} {name}") from None

    def __iter__(self) -> Iterator[tuple[Service, list[str]]]:
        for service in self._services.values():
            yield service, [node for node, name in self._clients if name == service.name]


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
        self.services = Offers("service")  # those of actions included
        self.actions = Offers("action")

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

    def add_parameter(self, parameter: NodeParameter) -> None:
        """Register a parameter that others may set."""
        self.parameters[parameter.node, parameter.name] = parameter

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


def _endpoints(by_topic: Mapping[str, list[_Endpoint]], topic: str | None) -> Iterator[_Endpoint]:
    if topic is not None:
        yield from by_topic.get(topic, [])
        return
    for endpoints in by_topic.values():
        yield from endpoints
