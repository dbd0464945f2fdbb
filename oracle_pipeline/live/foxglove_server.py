"""Serves a running watch to Foxglove by WebSocket, on this machine only.

Topics are forwarded unchanged, with their ROS 2 message definitions, so Foxglove shows scans,
paths, maps and transforms without further setup. As in DDS, clients that connect later get the
messages of latched topics again: without static transforms, scans cannot be placed on the map. The
server adds the verdicts on windows (``/oracle/window``), a log of alarms and notes
(``/oracle/log``), and the ROS graph for the panel Topic Graph. Clients cannot publish, and pages of
other sites cannot connect (``handshake_guard``). A layout is in ``docs/foxglove/live.json``.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Self

from oracle_pipeline.bags.errors import BagError, OracleError
from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.bags.types import definition
from oracle_pipeline.live.handshake_guard import HandshakeGuard, certificate
from oracle_pipeline.live.loopback import HOST, listen
from oracle_pipeline.live.watch import (
    Alarm,
    ContractAlarm,
    Event,
    GraphTaken,
    MessageReceived,
    Note,
)
from oracle_pipeline.live.window_scorer import WindowVerdict

if TYPE_CHECKING:
    from foxglove import Channel
    from foxglove.websocket import ChannelView, Client, ConnectionGraph, ServerListener

PORT = 8765  # Foxglove's own default
WINDOW_TOPIC, LOG_TOPIC = "/oracle/window", "/oracle/log"
ORIGINS = ("https://app.foxglove.dev",)  # of Foxglove in a browser
_LATCHED = 20  # last messages of a latched topic that are kept
_SECOND_NS = 1_000_000_000
WINDOW_SCHEMA = {
    "type": "object",
    "title": "oracle.Window",
    "properties": {
        **{name: {"type": "number"} for name in ("start_s", "end_s", "score", "p_value")},
        **{name: {"type": "boolean"} for name in ("usual", "alarm")},
    },
}


class FoxgloveError(OracleError):
    """Foxglove's SDK is not installed."""


class FoxgloveServer:
    """Serves a watch to Foxglove at a port (`listen`); a context manager.

    Raises
    ------
    FoxgloveError
        The SDK is not installed.
    """

    def __init__(self, port: int = PORT) -> None:
        try:
            import foxglove
            from foxglove.channels import LogChannel
        except ImportError as error:
            raise FoxgloveError(
                "Foxglove's SDK is not installed; in the checkout: pip install '.[live]'."
            ) from error
        self._context = foxglove.Context()
        self._socket = listen(port)
        own = certificate()
        self._server = foxglove.start_server(
            name="oracle watch",
            host=HOST,
            port=0,
            capabilities=[foxglove.Capability.ConnectionGraph],
            context=self._context,
            server_listener=_listener(self._resend),
            tls_cert=own.certificate,
            tls_key=own.key,
        )
        self._guard = HandshakeGuard(self._socket, self._server.port, own, ORIGINS)
        self.address = f"ws://{HOST}:{self._socket.getsockname()[1]}"
        self._channels: dict[str, Channel | None] = {}  # None: its definition is unknown
        self._latched: dict[str, deque[MessageReceived]] = {}  # by topic
        self._window = foxglove.Channel(WINDOW_TOPIC, schema=WINDOW_SCHEMA, context=self._context)
        self._log = LogChannel(LOG_TOPIC, context=self._context)
        self._start_ns: int | None = None
        self._now_ns = 0

    def show(self, event: Event) -> None:
        """Send an event to all connected clients."""
        if isinstance(event, MessageReceived):
            self._message(event)
        elif isinstance(event, GraphTaken):
            self._server.publish_connection_graph(_connections(event))
        elif isinstance(event, WindowVerdict):
            self._window.log(
                {
                    "start_s": event.start_s,
                    "end_s": event.end_s,
                    "score": event.score if math.isfinite(event.score) else None,
                    "p_value": event.p_value,
                    "usual": event.is_usual,
                    "alarm": event.alarm,
                },
                log_time=self._stamp_ns(event.end_s),
            )
        elif isinstance(event, Alarm):
            verdict = event.verdict
            named = ", ".join(each.feature for each in verdict.evidence)
            text = f"Anomalous from {verdict.start_s:g} s to {verdict.end_s:g} s: {named}"
            self._write_log(text, self._stamp_ns(verdict.end_s), is_alarm=True)
        elif isinstance(event, ContractAlarm):
            text = " ".join(breach.text for breach in event.breaches)
            self._write_log(text, self._stamp_ns(event.at_s), is_alarm=True)
        elif isinstance(event, Note):
            self._write_log(event.text, self._now_ns, is_alarm=False)

    def __enter__(self) -> Self:
        self._guard.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._guard.__exit__(*exception)
        self._server.stop()
        self._socket.close()

    def _message(self, event: MessageReceived) -> None:
        if self._start_ns is None:
            self._start_ns = event.stamp_ns
        self._now_ns = event.stamp_ns
        if event.topic not in self._channels:
            self._channels[event.topic] = self._channel(event)
        if event.latched:
            self._latched.setdefault(event.topic, deque(maxlen=_LATCHED)).append(event)
        self._forward(event)

    def _forward(self, event: MessageReceived) -> None:
        channel = self._channels[event.topic]
        if channel is not None:
            channel.log(event.data, log_time=event.stamp_ns)

    def _channel(self, event: MessageReceived) -> "Channel | None":
        from foxglove import Channel, Schema

        try:
            text = definition(event.msgtype)
        except BagError:
            return None
        schema = Schema(name=event.msgtype, encoding="ros2msg", data=text.encode())
        return Channel(event.topic, schema=schema, message_encoding="cdr", context=self._context)

    def _resend(self, topic: str) -> None:
        """Send the messages of latched topics again, such as maps and static transforms."""
        for event in tuple(self._latched.get(topic, ())):
            self._forward(event)

    def _stamp_ns(self, second: float) -> int:
        return (self._start_ns or 0) + round(second * _SECOND_NS)

    def _write_log(self, text: str, stamp_ns: int, *, is_alarm: bool) -> None:
        from foxglove.messages import Log, LogLevel, Timestamp

        level = LogLevel.Error if is_alarm else LogLevel.Warning
        stamp = Timestamp(*divmod(stamp_ns, _SECOND_NS))
        self._log.log(
            Log(timestamp=stamp, level=level, message=printable(text), name="oracle"),
            log_time=stamp_ns,
        )


def _listener(on_subscribe: Callable[[str], None]) -> "ServerListener":
    """Return a listener that calls a function with each topic that a client subscribes to."""
    from foxglove.websocket import ServerListener

    class Listener(ServerListener):
        def on_subscribe(self, client: "Client", channel: "ChannelView") -> None:  # noqa: ARG002
            on_subscribe(channel.topic)

    return Listener()


def _connections(event: GraphTaken) -> "ConnectionGraph":
    """Return the graph in the form of Foxglove's panel Topic Graph: nodes of each topic."""
    from foxglove import ConnectionGraph

    connections = ConnectionGraph()
    graph = event.graph
    for vertex, data in graph.nodes(data=True):
        if data["kind"] == "topic":
            publishers = [graph.nodes[node]["label"] for node in graph.predecessors(vertex)]
            subscribers = [graph.nodes[node]["label"] for node in graph.successors(vertex)]
            connections.set_published_topic(data["label"], publishers)
            connections.set_subscribed_topic(data["label"], subscribers)
    return connections
