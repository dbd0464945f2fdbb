"""Publishers and subscriptions of a topic, and delivery between them.

A sample is serialised at most once, however many subscribers it has. Endpoints are made through
``node``.
"""

from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rosbags.interfaces import Qos

from oracle_pipeline.bags.qos_profiles import compatible, is_latched
from oracle_pipeline.bags.types import deserialize, serialize
from sim.middleware.delays import Delays
from sim.middleware.executor import Executor


class Sample:
    """One published message, as an object, as CDR bytes, or as both."""

    __slots__ = ("_data", "_message", "msgtype")

    def __init__(self, msgtype: str, message: Any = None, data: bytes | None = None) -> None:
        self.msgtype = msgtype
        self._message = message
        self._data = data

    @property
    def message(self) -> Any:
        """The message object; all receivers share it, so no one may change it."""
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
    """A node's subscription to a topic; without a callback it only counts samples."""

    node: str
    topic: str
    msgtype: str
    qos: Qos
    callback: Callable[[Any], None] | None
    raw: bool  # the callback takes CDR bytes, at the moment of sending
    latency_ns: int
    delays: Delays | None = None  # added to the latency
    # Publishers, and what each had sent before it was connected: traffic is counted once, there.
    links: list[tuple["Publisher", int, int]] = field(default_factory=list)

    @property
    def messages(self) -> int:
        """Samples received so far."""
        return sum(publisher.messages - before for publisher, before, _ in self.links)

    @property
    def message_bytes(self) -> int:
        """Their CDR bytes, while a recorder was connected."""
        return sum(publisher.message_bytes - before for publisher, _, before in self.links)

    def due_ns(self, sent_ns: int) -> int:
        """Return when a sample that is sent now arrives [ns]."""
        if self.delays is None:
            return sent_ns + self.latency_ns
        return self.delays.due_ns(sent_ns, self.latency_ns)

    def deliver(self, sample: Sample) -> None:
        """Pass a sample to the callback."""
        if self.callback is not None:
            self.callback(sample.data if self.raw else sample.message)


class _Listener(NamedTuple):
    """A subscription with a callback, as the publisher sees it."""

    latency_ns: int
    delays: Delays | None
    receive: Callable[[Any], None]  # takes a message
    deliver: Callable[[Sample], None]


@dataclass(slots=True, eq=False)
class Publisher:
    """A node's publisher of a topic."""

    executor: Executor
    node: str
    topic: str
    msgtype: str
    qos: Qos
    subscriptions: list[Subscription] = field(default_factory=list)
    retained: deque[Sample] | None = None  # for late subscribers, when latched
    messages: int = 0
    message_bytes: int = (
        0  # sent while a recorder was connected; without one, nothing need be serialised
    )
    # Gets published messages, and sends others in their place; the graph does not show it.
    alter: Callable[[Sample], None] | None = None
    _recorders: list[Callable[[bytes], None]] = field(default_factory=list)
    _listeners: list["_Listener"] = field(default_factory=list)
    _links: "_Links | None" = None

    def publish(self, message: Any, data: bytes | None = None) -> None:
        """Send a message object; the caller must not change it afterwards.

        ``data`` are its CDR bytes, if the caller has them cheaper than by serialising.
        """
        if self.alter is None:
            self.send(message, data)
        else:
            self.alter(Sample(self.msgtype, message, data))

    def send(self, message: Any, data: bytes | None = None) -> None:
        """Send a message object unaltered, even if an attack alters what is published."""
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
        for latency_ns, delays, receive, _ in self._listeners:
            due_ns = now_ns + latency_ns if delays is None else delays.due_ns(now_ns, latency_ns)
            call_at(due_ns, receive, message)
        if self._links is not None:
            self._links.alter(Sample(self.msgtype, message, data))

    def publish_serialized(self, data: bytes) -> None:
        """Send CDR bytes; they become a message only for subscribers that need one."""
        if self.alter is not None:
            self.alter(Sample(self.msgtype, data=data))
            return
        self.messages += 1
        if self._recorders:
            self.message_bytes += len(data)
            for record in self._recorders:
                record(data)
        if self._listeners or self.retained is not None:
            self._forward(Sample(self.msgtype, data=data))
        if self._links is not None:
            self._links.alter(Sample(self.msgtype, data=data))

    def divert(self, nodes: Collection[str], alter: Callable[[Sample], None]) -> None:
        """Send some nodes only the messages from ``alter``, by `send_diverted`.

        All others receive the published messages, and the graph and its traffic do not change. It
        models a transport that delays, loses or alters samples on the way to one reader.
        """
        self._links = _Links(frozenset(nodes), alter)
        subscriptions, self._listeners = self.subscriptions, []
        for subscription in subscriptions:
            self._listen(subscription)

    def send_diverted(self, message: Any) -> None:
        """Send a message object only to the nodes that are diverted."""
        if self._links is None:
            raise ValueError(f"no subscriber of {self.topic} is diverted; call divert first")
        now_ns, call_at = self.executor.now_ns, self.executor.call_at
        for latency_ns, delays, receive, _ in self._links.listeners:
            due_ns = now_ns + latency_ns if delays is None else delays.due_ns(now_ns, latency_ns)
            call_at(due_ns, receive, message)

    def _forward(self, sample: Sample) -> None:
        if self.retained is not None:
            self.retained.append(sample)
        now_ns, call_at = self.executor.now_ns, self.executor.call_at
        for latency_ns, delays, _, deliver in self._listeners:
            due_ns = now_ns + latency_ns if delays is None else delays.due_ns(now_ns, latency_ns)
            call_at(due_ns, deliver, sample)

    def offer(self, qos: Qos) -> list[str]:
        """Offer another profile, like a restarted publisher; return nodes that receive nothing now.

        Taps, and subscriptions that take raw bytes, adapt to any offer, as rosbag2 does.
        """
        self.qos = qos
        if not is_latched(qos):
            self.retained = None
        elif self.retained is None:
            self.retained = deque(maxlen=qos.depth)
        self._listeners.clear()
        if self._links is not None:
            self._links.listeners.clear()
        cut_off = []
        for subscription in self.subscriptions:
            if compatible(qos, subscription.qos):
                self._listen(subscription)
            elif subscription.callback is not None and not subscription.raw:
                cut_off.append(subscription.node)
        return cut_off

    def tap(self, callback: Callable[[bytes], None]) -> None:
        """Pass the bytes of each message to a function, beginning with those kept for late joiners.

        A tap is not a subscriber, so nothing in the domain changes.
        """
        self._recorders.append(callback)
        for sample in self.retained or ():
            callback(sample.data)

    def has_subscribers(self) -> bool:
        """Return whether there is a subscription (Nav2 skips costly messages without one)."""
        return bool(self.subscriptions)

    def has_receiver(self) -> bool:
        """Return whether any subscriber has a callback for a sample."""
        return bool(self._recorders or self._listeners or self._links)

    def connect(self, subscription: Subscription) -> None:
        """Send to a subscription from now on; if latched, also what was sent last."""
        self.subscriptions.append(subscription)
        callback = subscription.callback
        if callback is not None and subscription.raw:
            self._recorders.append(callback)
        else:
            self._listen(subscription)
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

    def _listen(self, subscription: Subscription) -> None:
        """Let a subscription receive messages, if it has a callback for them."""
        callback, links = subscription.callback, self._links
        if callback is None or subscription.raw:
            return
        diverted = links is not None and subscription.node in links.nodes
        listeners = links.listeners if links is not None and diverted else self._listeners
        listeners.append(
            _Listener(subscription.latency_ns, subscription.delays, callback, subscription.deliver)
        )


@dataclass(frozen=True, slots=True)
class _Links:
    """The links of a publisher to nodes that receive altered messages."""

    nodes: frozenset[str]
    alter: Callable[[Sample], None]
    listeners: list[_Listener] = field(default_factory=list)
