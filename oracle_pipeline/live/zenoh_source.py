"""ROS 2 over Zenoh, as ``rmw_zenoh`` speaks it, as a source of messages.

Liveliness tokens tell nodes and endpoints [1]_. A message is CDR, as on DDS. Its attachment has its
number, its time and its publisher, so what is lost on the way is counted.

References
----------
.. [1] https://github.com/ros2/rmw_zenoh, ``liveliness_utils.cpp`` and ``attachment_helpers.cpp``
"""

import json
import queue
import re
import struct
import time
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, TypeAlias

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosReliability

from oracle_pipeline.bags import types
from oracle_pipeline.bags.dds_names import dds_type, ros_type
from oracle_pipeline.bags.discovery import ENTITIES_QOS, Discovery, Endpoint
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.live.intake import Intake, Received
from oracle_pipeline.live.source import Source

try:
    import xxhash
    import zenoh
except ImportError as error:
    raise OracleError(
        "Eclipse Zenoh is not installed; in the checkout, install it with "
        "`python -m pip install '.[live,zenoh]'`."
    ) from error

Session: TypeAlias = Any  # a type checker may run where Zenoh is not installed

_TOKENS = "@ros2_lv"
_PUBLISHER, _SUBSCRIPTION, _NODE = "MP", "MS", "NN"
_NUMBERS = struct.Struct("<qq")  # of the message, and nanoseconds since 1970
_GUID = 16  # bytes
_DEPTH = 42  # where a token does not say it
_CACHED = 500  # messages of a latched topic, at most
_NAME = re.compile(r"(/[A-Za-z_]\w*)+", re.ASCII)  # of a topic; `*` would match others


def guid_of(token: str) -> bytes:
    """Return the identifier of an endpoint, which its messages carry: a hash of its token."""
    return int(xxhash.xxh3_128_intdigest(token.encode())).to_bytes(_GUID, "little")


class ZenohDiscovery(Discovery):
    """Keeps what the tokens of a domain say."""

    def __init__(self, session: Session, domain: int) -> None:
        super().__init__()
        self._nodes: dict[str, str] = {}  # by token
        self._new: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        self._subscriber = session.liveliness().declare_subscriber(
            f"{_TOKENS}/{domain}/**",
            lambda each: self._new.put((str(each.key_expr), each.kind == zenoh.SampleKind.PUT)),
            history=True,
        )

    def update(self) -> bool:
        """Take the new tokens; return whether there were any."""
        before = self.revision
        while not self._new.empty():
            token, alive = self._new.get()
            self.revision += 1
            self._nodes.pop(token, None)
            self.endpoints.pop(_handle(guid_of(token)), None)
            if alive:
                self._add(token)
        return self.revision != before

    def nodes(self) -> Iterable[Mapping[str, frozenset[bytes]]]:
        """Return all nodes, with the guids of their endpoints."""
        return [{name: frozenset((guid_of(token),))} for token, name in self._nodes.items()]

    def _add(self, token: str) -> None:
        parts = token.split("/")
        if len(parts) < 9 or parts[5] not in (_NODE, _PUBLISHER, _SUBSCRIPTION):
            return  # of a service
        self._nodes[token] = f"{_plain(parts[7]).rstrip('/')}/{_plain(parts[8])}"
        if parts[5] != _NODE and len(parts) == 13 and (msgtype := ros_type(parts[10])):
            guid = guid_of(token)
            self.endpoints[_handle(guid)] = Endpoint(
                guid, _handle(guid), parts[2].encode(), _plain(parts[9]), msgtype,
                _qos(parts[12]), parts[5] == _PUBLISHER,
            )  # fmt: skip


class ZenohIntake(Intake):
    """Subscribes to topics of a domain; Zenoh's threads queue the messages."""

    def __init__(self, session: Session, domain: int) -> None:
        super().__init__()
        self._session, self._domain = session, domain
        self._subscribers: list[Any] = []
        self._numbers: dict[bytes, int] = {}  # of the newest message of each publisher

    def subscribe(self, topic: str, msgtype: str, *, reliable: bool, latched: bool) -> None:
        """Subscribe to a topic; what a latched one has sent before comes, too."""
        if msgtype not in types.typestore().fielddefs:
            raise OracleError(f"The message type {msgtype} is not known.")
        if not _NAME.fullmatch(topic):
            raise OracleError("Its name is none of ROS 2.")
        super().subscribe(topic, msgtype, reliable=reliable, latched=latched)
        key = f"{self._domain}{topic}/{dds_type(msgtype)}/*"  # the last part is a hash of the type
        before = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=_CACHED)
        take, history = partial(self._take, topic), before if latched else None
        subscribe: Any = zenoh.ext.declare_advanced_subscriber
        self._subscribers.append(subscribe(self._session, key, take, history=history))

    def _take(self, topic: str, sample: Any) -> None:
        told = b"" if sample.attachment is None else bytes(sample.attachment)
        if len(told) < _NUMBERS.size + _GUID:
            return  # not of ROS
        (number, sent_ns), guid = _NUMBERS.unpack_from(told), told[-_GUID:]
        last = self._numbers.get(guid, number)
        self._numbers[guid] = max(number, last)
        self.count_lost(topic, number - last - 1)
        now, data = (time.time_ns(), time.monotonic_ns()), bytes(sample.payload)
        self.put([Received(topic, sent_ns, *now, _handle(guid), data)])


class ZenohRouter(Source):
    """Joins the domain behind a router, and only reads.

    Parameters
    ----------
    endpoint : str
        Of the router, such as ``tcp/127.0.0.1:7447``.
    domain : int
        Which ROS domain.

    Raises
    ------
    OracleError
        If there is no router.
    """

    def __init__(self, endpoint: str, domain: int) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        try:
            self._session: Session = zenoh.open(config)
        except zenoh.ZError as error:
            raise OracleError(
                f"There is no Zenoh router at {endpoint} ({error}); start it, or correct --zenoh."
            ) from error
        intake = ZenohIntake(self._session, domain)
        discovery = ZenohDiscovery(self._session, domain)
        super().__init__({"domain": domain, "zenoh": endpoint}, discovery, intake)

    def close(self) -> None:
        """Leave."""
        self._session.close()


def _handle(guid: bytes) -> int:
    return int.from_bytes(guid, "little")


def _plain(name: str) -> str:
    """Return a name of which a token has no slashes."""
    return name.replace("%", "/")


def _qos(text: str) -> Qos:
    """Return the profile in a token; what is ROS 2's default, is left out there."""
    reliability, durability, history, *_ = [*text.split(":"), "", ""]
    kept, _, depth = history.partition(",")
    return ENTITIES_QOS._replace(
        history=QosHistory.KEEP_ALL if kept == "2" else QosHistory.KEEP_LAST,
        depth=int(depth[:9]) if depth.isdecimal() else _DEPTH,  # anyone can write a token
        reliability=QosReliability.BEST_EFFORT if reliability == "2" else QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if durability == "1" else QosDurability.VOLATILE,
    )
