"""One ROS domain: who is in the graph, what each publishes and hears, and delivery.

Introspection answers what ``ros2 node list`` and ``ros2 node info`` answer. Endpoints are made
through ``node``; a sample is serialised at most once, whoever listens.
"""

import functools
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from rosbags.interfaces import Qos

from oracle_pipeline.bags.qos_profiles import compatible, is_latched
from oracle_pipeline.bags.types import deserialize, serialize
from sim.middleware.delays import Delays
from sim.middleware.executor import Executor

_Endpoint = TypeVar("_Endpoint")


class Sample:
    """One published message, as an object, as CDR bytes, or as both."""

    __slots__ = ("_data", "_message", "msgtype")

    def __init__(self, msgtype: str, message: Any = None, data: bytes | None = None) -> None:
        self.msgtype = msgtype
        self._message = message
        self._data = data

    @property
    def message(self) -> Any:
        """The message object; shared by all receivers, so nobody writes to it."""
        if self._message is None:
            self._message = deserialize(self.data, self.msgtype)
        return self._message

    @property
    def data(self) -> bytes:
        """The CDR bytes, encapsulation header included."""
        if self._data is None:
            self._data = serialize(self._message, self.msgtype)
        return self._data


@dataclass(slots=True, eq=False)
class Subscription:
    """One node's interest in a topic; without a callback it only counts."""

    node: str
    topic: str
    msgtype: str
    qos: Qos
    callback: Callable[[Any], None] | None
    raw: bool  # the callback takes CDR bytes, in the instant they are sent
    latency_ns: int
    delays: Delays | None = None  # what is added to the latency
    # Publishers, and what each had sent before it was connected: traffic is counted once, there.
    links: list[tuple["Publisher", int, int]] = field(default_factory=list)

    @property
    def messages(self) -> int:
        """Samples received so far."""
        return sum(publisher.messages - before for publisher, before, _ in self.links)

    @property
    def message_bytes(self) -> int:
        """Their CDR bytes, as far as a recorder listened."""
        return sum(publisher.message_bytes - before for publisher, _, before in self.links)

    def due_ns(self, sent_ns: int) -> int:
        """Return when a sample is heard that is sent now [ns]."""
        if self.delays is None:
            return sent_ns + self.latency_ns
        return self.delays.due_ns(sent_ns, self.latency_ns)

    def deliver(self, sample: Sample) -> None:
        """Hand a sample to the callback."""
        if self.callback is not None:
            self.callback(sample.data if self.raw else sample.message)


class _Listener(NamedTuple):
    """A subscription that does something with what it hears, as the publisher looks at it."""

    latency_ns: int
    delays: Delays | None
    hear: Callable[[Any], None]  # takes a message
    deliver: Callable[[Sample], None]


@dataclass(slots=True, eq=False)
class Publisher:
    """One node's voice on a topic."""

    executor: Executor
    node: str
    topic: str
    msgtype: str
    qos: Qos
    subscriptions: list[Subscription] = field(default_factory=list)
    retained: deque[Sample] | None = None  # for late subscribers, when latched
    messages: int = 0
    message_bytes: int = 0  # sent while a recorder listened; else nothing need be serialised
    # Takes what is published, and sends what it likes instead; the graph does not show it.
    alter: Callable[[Sample], None] | None = None
    _recorders: list[Callable[[bytes], None]] = field(default_factory=list)
    _listeners: list["_Listener"] = field(default_factory=list)

    def publish(self, message: Any, data: bytes | None = None) -> None:
        """Send a message object; the caller must not change it afterwards.

        ``data`` are its CDR bytes, if the caller has them cheaper than by serialising.
        """
        if self.alter is None:
            self.send(message, data)
        else:
            self.alter(Sample(self.msgtype, message, data))

    def send(self, message: Any, data: bytes | None = None) -> None:
        """Send a message object as it is, even where what is published is altered."""
        self.messages += 1
        if self._recorders:
            if data is None:
                data = serialize(message, self.msgtype)
            self.message_bytes += len(data)
            for record in self._recorders:
                record(data)
        if self.retained is not None:
            self.retained.append(Sample(self.msgtype, message, data))
        now_ns, call_at = self.executor.now_ns, self.executor.call_at
        for latency_ns, delays, hear, _ in self._listeners:
            due_ns = now_ns + latency_ns if delays is None else delays.due_ns(now_ns, latency_ns)
            call_at(due_ns, hear, message)

    def publish_serialized(self, data: bytes) -> None:
        """Send CDR bytes; they become a message if somebody listens."""
        if self.alter is not None:
            self.alter(Sample(self.msgtype, data=data))
            return
        self.messages += 1
        if self._recorders:
            self.message_bytes += len(data)
            for record in self._recorders:
                record(data)
        if self._listeners or self.retained is not None:
            self._hand_on(Sample(self.msgtype, data=data))

    def _hand_on(self, sample: Sample) -> None:
        if self.retained is not None:
            self.retained.append(sample)
        now_ns, call_at = self.executor.now_ns, self.executor.call_at
        for latency_ns, delays, _, deliver in self._listeners:
            due_ns = now_ns + latency_ns if delays is None else delays.due_ns(now_ns, latency_ns)
            call_at(due_ns, deliver, sample)

    def tap(self, callback: Callable[[bytes], None]) -> None:
        """Hand on the bytes of each message from now on, and of those that are kept for late ones.

        Who taps is no subscriber: nothing in the domain changes.
        """
        self._recorders.append(callback)
        for sample in self.retained or ():
            callback(sample.data)

    def has_subscribers(self) -> bool:
        """Tell whether a sample would reach anyone (Nav2 skips costly messages otherwise)."""
        return bool(self.subscriptions)

    def is_heard(self) -> bool:
        """Tell whether any of the subscribers does something with a sample."""
        return bool(self._recorders or self._listeners)

    def connect(self, subscription: Subscription) -> None:
        """Send to a subscription from now on; if latched, what was sent last as well."""
        self.subscriptions.append(subscription)
        callback = subscription.callback
        if callback is not None and subscription.raw:
            self._recorders.append(callback)
        elif callback is not None:
            self._listeners.append(
                _Listener(
                    subscription.latency_ns, subscription.delays, callback, subscription.deliver
                )
            )
        late = list(self.retained or ()) if is_latched(subscription.qos) else []
        size = sum(len(sample.data) for sample in late) if self._recorders else 0
        subscription.links.append((self, self.messages - len(late), self.message_bytes - size))
        for sample in late:
            if subscription.raw:
                subscription.deliver(sample)
            else:
                self.executor.call_at(
                    subscription.due_ns(self.executor.now_ns), subscription.deliver, sample
                )


@dataclass(slots=True, eq=False)
class Service:
    """A named function of one node that others may call."""

    node: str
    name: str
    srvtype: str
    handler: Callable[[Any], Any]


@dataclass(slots=True, eq=False)
class ActionEndpoint:
    """A named action and the object that serves it."""

    node: str
    name: str
    action_type: str
    server: Any


class Offer(NamedTuple):
    """A service or an action: what it is, which node offers it, and which ask for it."""

    name: str
    type: str
    server: str
    clients: list[str]


class Domain:
    """Everything that can see each other, as with one ``ROS_DOMAIN_ID``.

    Parameters
    ----------
    executor
        Simulated time.
    delays
        What is added to the latency of a node, by its name; None: nothing. A node without latency
        hears everything at once.
    """

    def __init__(
        self, executor: Executor, delays: Callable[[str], Delays | None] = lambda _: None
    ) -> None:
        self.executor = executor
        self._delays = functools.cache(delays)  # all subscriptions of a node share them
        self.revision = 0  # counts publishers: who looks for new ones need not look when it stands
        self.topics: dict[str, str] = {}  # name -> message type, in order of appearance
        self._publishers: dict[str, list[Publisher]] = {}  # by topic
        self._subscriptions: dict[str, list[Subscription]] = {}  # by topic
        self._nodes: dict[str, None] = {}
        self._services: dict[str, Service] = {}
        self._clients: list[tuple[str, str, str]] = []  # node, service, type
        self._action_servers: dict[str, ActionEndpoint] = {}  # by action
        self._action_clients: list[tuple[str, str, str]] = []  # node, action, type

    # -- making endpoints (called by Node) -------------------------------------------------

    def add_node(self, name: str) -> None:
        """Register a node by its full name."""
        if name in self._nodes:
            raise ValueError(f"node {name} is in the graph already; give this one another name")
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

    def add_action_server(self, endpoint: ActionEndpoint) -> None:
        """Register the server of an action."""
        self._action_servers[endpoint.name] = endpoint

    def add_action_client(self, node: str, name: str, action_type: str) -> None:
        """Register a node as a client of an action."""
        self._action_clients.append((node, name, action_type))

    def service(self, name: str) -> Service:
        """Return a service that is up."""
        try:
            return self._services[name]
        except KeyError:
            raise LookupError(f"no node offers the service {name}") from None

    def action_server(self, name: str) -> Any:
        """Return the server of an action that is up."""
        try:
            return self._action_servers[name].server
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

    def publishers_of(self, node: str) -> dict[str, str]:
        """Return topic -> type of what a node publishes, as ``ros2 node info`` does."""
        return {p.topic: p.msgtype for p in self.publishers() if p.node == node}

    def subscriptions_of(self, node: str) -> dict[str, str]:
        """Return topic -> type of what a node subscribes to."""
        return {s.topic: s.msgtype for s in self.subscriptions() if s.node == node}

    def services_of(self, node: str) -> dict[str, str]:
        """Return service -> type of what a node offers."""
        return {s.name: s.srvtype for s in self._services.values() if s.node == node}

    def clients_of(self, node: str) -> dict[str, str]:
        """Return service -> type of what a node calls."""
        return {name: srvtype for owner, name, srvtype in self._clients if owner == node}

    def action_servers_of(self, node: str) -> dict[str, str]:
        """Return action -> type of what a node serves."""
        return {a.name: a.action_type for a in self._action_servers.values() if a.node == node}

    def action_clients_of(self, node: str) -> dict[str, str]:
        """Return action -> type of what a node asks for."""
        return {name: kind for owner, name, kind in self._action_clients if owner == node}

    def services(self) -> Iterator[Offer]:
        """Yield the services of all nodes, those of actions included."""
        for service in self._services.values():
            clients = [node for node, name, _ in self._clients if name == service.name]
            yield Offer(service.name, service.srvtype, service.node, clients)

    def actions(self) -> Iterator[Offer]:
        """Yield the actions of all nodes."""
        for action in self._action_servers.values():
            clients = [node for node, name, _ in self._action_clients if name == action.name]
            yield Offer(action.name, action.action_type, action.node, clients)


def _endpoints(by_topic: Mapping[str, list[_Endpoint]], topic: str | None) -> Iterator[_Endpoint]:
    if topic is not None:
        yield from by_topic.get(topic, [])
        return
    for endpoints in by_topic.values():
        yield from endpoints
