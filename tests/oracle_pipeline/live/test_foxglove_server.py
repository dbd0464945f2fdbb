"""Foxglove's WebSocket forwards a watch: a real client receives the same bytes."""

import json
import socket
import ssl
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from websockets.sync.client import ClientConnection, connect

from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import deserialize
from oracle_pipeline.live.foxglove_server import (
    LOG_TOPIC,
    WINDOW_SCHEMA,
    WINDOW_TOPIC,
    FoxgloveServer,
)
from oracle_pipeline.live.loopback import PortError
from oracle_pipeline.live.watch import Alarm, MessageReceived, Note
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.live.happenings import HOSTILE, contract_alarm, graph, messages, verdict

LAYOUT = Path(__file__).parents[3] / "docs" / "foxglove" / "live.json"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
_MESSAGE = struct.Struct("<BIQ")  # opcode, subscription, log time [ns]


class Client:
    """As Foxglove does: learn of channels, subscribe to all, take what comes."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.channels: dict[int, dict[str, str]] = {}
        self.told: dict[str, dict] = {}

    def until(self, op: str) -> dict:
        """Return the next message of one kind in JSON."""
        while op not in self.told:
            text = self.connection.recv(10)
            assert isinstance(text, str)
            message = json.loads(text)
            self.told[message["op"]] = message
            if message["op"] == "advertise":
                self.channels |= {each["id"]: each for each in message["channels"]}
        return self.told.pop(op)

    def subscribe(self, topics: set[str]) -> None:
        while not topics <= {each["topic"] for each in self.channels.values()}:
            self.until("advertise")
        wanted = [
            {"id": number, "channelId": number}
            for number, each in self.channels.items()
            if each["topic"] in topics
        ]
        self.connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def take(self) -> tuple[str, int, bytes]:
        """Return topic, log time and bytes of the next message."""
        while isinstance(data := self.connection.recv(10), str):
            pass
        opcode, number, stamp_ns = _MESSAGE.unpack_from(data)
        assert opcode == 1
        return self.channels[number]["topic"], stamp_ns, data[_MESSAGE.size :]


@pytest.fixture
def server() -> Iterator[FoxgloveServer]:
    with FoxgloveServer(0) as server:
        yield server


@pytest.fixture
def client(server: FoxgloveServer) -> Iterator[Client]:
    with connect(server.address, subprotocols=["foxglove.sdk.v1"]) as connection:  # type: ignore[list-item]
        yield Client(connection)


def subscribed(server: FoxgloveServer, client: Client, topic: str, show: object) -> bytes:
    """Show an event until it comes: a subscription takes effect a moment later."""
    client.subscribe({topic})
    while True:
        server.show(show)  # type: ignore[arg-type]
        try:
            data = client.connection.recv(0.2)
        except TimeoutError:
            continue
        if not isinstance(data, str):
            return data


def test_a_message_keeps_its_bytes_from_dds_and_has_its_definition(
    server: FoxgloveServer, client: Client
) -> None:
    scan = next(message for message in messages() if message.topic == "/scan")
    server.show(scan)
    data = subscribed(server, client, "/scan", scan)
    assert data[_MESSAGE.size :] == scan.data
    assert _MESSAGE.unpack_from(data)[2] == scan.stamp_ns
    assert deserialize(data[_MESSAGE.size :], scan.msgtype).header.frame_id
    (channel,) = [each for each in client.channels.values() if each["topic"] == "/scan"]
    assert (channel["encoding"], channel["schemaName"]) == ("cdr", scan.msgtype)
    assert channel["schemaEncoding"] == "ros2msg"
    assert "float32[] ranges" in channel["schema"]


def test_a_verdict_stands_at_the_end_of_its_window(server: FoxgloveServer, client: Client) -> None:
    server.show(next(messages()))
    data = subscribed(server, client, WINDOW_TOPIC, verdict(3, alarm=True))
    began = next(messages()).stamp_ns
    assert _MESSAGE.unpack_from(data)[2] == began + 12_500_000_000
    assert json.loads(data[_MESSAGE.size :]) == {
        "start_s": 7.5, "end_s": 12.5, "score": 9.0, "p_value": 0.01, "usual": False,
        "alarm": True,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("event", "words"),
    [
        (Alarm(verdict(3, alarm=True)), b"Anomalous from 7.5 s to 12.5 s"),
        (contract_alarm(), b"is new."),
        (Note("dropped"), b"dropped"),
    ],
    ids=["alarm", "contract", "note"],
)
def test_alarms_and_notes_are_in_the_log(
    server: FoxgloveServer, client: Client, event: object, words: bytes
) -> None:
    assert words in subscribed(server, client, LOG_TOPIC, event)


def test_the_graph_is_that_of_the_panel_topic_graph(server: FoxgloveServer, client: Client) -> None:
    client.connection.send(json.dumps({"op": "subscribeConnectionGraph"}))
    client.until("connectionGraphUpdate")
    server.show(graph())
    update = client.until("connectionGraphUpdate")
    published = {each["name"]: each["publisherIds"] for each in update["publishedTopics"]}
    assert published["/scan"] == ["/turtlebot3_laserscan"]
    assert published[HOSTILE] == ["/spy"]
    subscribed_to = {each["name"]: each["subscriberIds"] for each in update["subscribedTopics"]}
    assert "/amcl" in subscribed_to["/scan"]


def test_clients_cannot_publish_or_set_anything(client: Client) -> None:
    assert client.until("serverInfo")["capabilities"] == ["connectionGraph"]


def test_it_listens_on_loopback_and_reports_a_port_in_use(server: FoxgloveServer) -> None:
    assert server.address.startswith("ws://127.0.0.1:")
    port = int(server.address.rpartition(":")[2])
    with pytest.raises(PortError, match=str(port)):
        FoxgloveServer(port)


def test_a_late_subscriber_gets_all_transforms_so_scans_can_be_placed_on_the_map(
    server: FoxgloveServer, client: Client, recorded_run: Callable[..., RunDirectory]
) -> None:
    with open_run(recorded_run("lidar_passthrough").path) as run:
        received = [
            MessageReceived(
                m.topic, TRANSFORMS, m.stamp_ns, m.data, latched=m.topic == "/tf_static"
            )
            for m in run.bag.messages(("/tf", "/tf_static"))
        ]
        scan = next(iter(run.bag.messages(["/scan"])))
        frame = deserialize(scan.data, run.bag.topics["/scan"].msgtype).header.frame_id
    for event in received:
        server.show(event)
    client.subscribe({"/tf_static"})
    parents: dict[str, str] = {}
    while frame not in parents:
        topic, _, data = client.take()
        assert topic == "/tf_static"
        parents |= frames(data)
    for event in received:
        if event.topic == "/tf":
            parents |= frames(event.data)
    while frame in parents:
        frame = parents[frame]
    assert frame == "map"


def frames(data: bytes) -> dict[str, str]:
    """Return the parent of each frame that a message of transforms names."""
    message = deserialize(data, TRANSFORMS)
    return {each.child_frame_id: each.header.frame_id for each in message.transforms}


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Host": "rebound.example:8765"},
    ],
    ids=["another site", "a site that hides", "a name that was bound anew"],
)
def test_pages_of_other_sites_cannot_connect(
    server: FoxgloveServer, headers: dict[str, str]
) -> None:
    assert answer(server.address, headers).startswith("HTTP/1.1 403")


@pytest.mark.parametrize("origin", ["https://app.foxglove.dev", "http://localhost:8080", "file://"])
def test_foxglove_itself_can_connect(server: FoxgloveServer, origin: str) -> None:
    assert answer(server.address, {"Origin": origin}).startswith("HTTP/1.1 101")


def test_connections_need_the_guard(server: FoxgloveServer) -> None:
    port = server._server.port
    with pytest.raises(ssl.SSLCertVerificationError):
        connect(f"wss://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"])  # type: ignore[list-item]


def answer(address: str, headers: dict[str, str]) -> str:
    """Return the first line of what is answered to a handshake."""
    at = urlsplit(address)
    all_headers = {
        "Host": at.netloc, "Upgrade": "websocket", "Connection": "Upgrade",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": "foxglove.sdk.v1", **headers,
    }  # fmt: skip
    lines = ["GET / HTTP/1.1", *(f"{name}: {value}" for name, value in all_headers.items())]
    with socket.create_connection((at.hostname, at.port), timeout=10) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        return connection.recv(100).decode(errors="replace")


def test_the_layout_shows_what_the_server_has() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    fields = {f"{WINDOW_TOPIC}.{name}" for name in WINDOW_SCHEMA["properties"]}
    assert set(paths) <= fields
    assert panels["RosOut!alarms"]["topicToRender"] == LOG_TOPIC
    text = json.dumps(layout["layout"])
    assert all(text.count(json.dumps(panel)) == 1 for panel in panels)
    assert "TopicGraph!graph" in panels
