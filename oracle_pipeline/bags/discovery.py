"""What a running system consists of now: ROS nodes, their publishers and subscriptions.

Each source of messages has a discovery of its own, which keeps this up to date.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability
from rosbags.interfaces import QosTime as _QosTime

UNKNOWN_NODE = "/_NODE_NAME_UNKNOWN_"  # ROS 2's name for an endpoint that no node claims

_NO_LIMIT = _QosTime(9223372036, 854775807)
ENTITIES_QOS = Qos(
    QosHistory.KEEP_ALL, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
    _NO_LIMIT, _NO_LIMIT, QosLiveliness.AUTOMATIC, _NO_LIMIT, False,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A publisher or a subscription of a ROS topic."""

    guid: bytes
    handle: int  # the source's handle of the publisher of a message
    participant: bytes
    topic: str
    msgtype: str
    qos: Qos
    publishes: bool


class Discovery(ABC):
    """Tracks the current state of a system.

    Attributes
    ----------
    endpoints : dict of int to Endpoint
        The current ones, by handle.
    revision : int
        Number of changes so far.
    """

    def __init__(self) -> None:
        self.endpoints: dict[int, Endpoint] = {}
        self.revision = 0

    @abstractmethod
    def update(self) -> bool:
        """Take what is new; return whether anything changed."""

    @abstractmethod
    def nodes(self) -> Iterable[Mapping[str, frozenset[bytes]]]:
        """Return the nodes of each current participant, with the guids of their endpoints."""

    def node_names(self) -> list[str]:
        """Return the full name of every node, as ``ros2 node list`` does."""
        claimed = {name for nodes in self.nodes() for name in nodes}
        return sorted(claimed | {node for _, node in self.owned() if node == UNKNOWN_NODE})

    def owned(self) -> Iterator[tuple[Endpoint, str]]:
        """Yield the endpoints, each with the name of its node."""
        owner = {guid: name for nodes in self.nodes() for name, of in nodes.items() for guid in of}
        for endpoint in self.endpoints.values():
            yield endpoint, owner.get(endpoint.guid, UNKNOWN_NODE)

    def topics(self) -> dict[str, list[Endpoint]]:
        """Return the publishers of each topic that has any."""
        publishers: dict[str, list[Endpoint]] = {}
        for endpoint in self.endpoints.values():
            if endpoint.publishes:
                publishers.setdefault(endpoint.topic, []).append(endpoint)
        return publishers
