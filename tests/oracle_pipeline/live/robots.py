"""Small robots on a DDS domain: nodes with publishers and subscriptions, as of ROS 2."""

from dataclasses import dataclass, field

import numpy as np

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_names import ENTITIES_TOPIC, ENTITIES_TYPE, dds_topic
from oracle_pipeline.bags.types import message_class, serialize
from sim.middleware.qos import DEFAULT, LATCHED

STRING = "std_msgs/msg/String"
TEXT = serialize(message_class(STRING)("hello"), STRING)

_Gid = message_class("rmw_dds_common/msg/Gid")
_Node = message_class("rmw_dds_common/msg/NodeEntitiesInfo")
_Participant = message_class("rmw_dds_common/msg/ParticipantEntitiesInfo")


@dataclass
class Robot:
    """One participant with some nodes."""

    domain: int
    namespace: str = ""
    writers: dict = field(default_factory=dict)  # by node and topic
    readers: dict = field(default_factory=dict)

    def __post_init__(self):
        self.participant = dds.join(self.domain)
        self._told = dds.RawWriter(self.participant, ENTITIES_TOPIC, ENTITIES_TYPE, LATCHED)

    def node(self, name, *, publishes=(), hears=(), qos=DEFAULT):
        """Add a node and its endpoints; topics are of strings."""
        for topic in publishes:
            self.writers[name, self.namespace + topic] = dds.RawWriter(
                self.participant, dds_topic(self.namespace + topic), STRING, qos
            )
        for topic in hears:
            self.readers[name, self.namespace + topic] = dds.RawReader(
                self.participant, dds_topic(self.namespace + topic), STRING, qos
            )
        return self

    def tell(self):
        """Tell whose the endpoints are, as every ROS 2 process does."""
        names = {name: None for name, _ in (*self.writers, *self.readers)}
        nodes = [
            _Node(
                self.namespace or "/",
                name,
                self._of(self.readers, name),
                self._of(self.writers, name),
            )
            for name in names
        ]
        gid = _gid(self.participant.guid.bytes)
        self._told.write(serialize(_Participant(gid, nodes), ENTITIES_TYPE))
        return self

    def _of(self, endpoints, name):
        return [_gid(endpoint.guid) for (node, _), endpoint in endpoints.items() if node == name]


def _gid(guid):
    return _Gid(np.frombuffer(guid.ljust(24, b"\0"), dtype=np.uint8))
