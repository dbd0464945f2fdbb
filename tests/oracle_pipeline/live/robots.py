"""Small robots on a DDS domain: nodes with publishers and subscriptions, as of ROS 2."""

from dataclasses import dataclass, field

import numpy as np
from rosbags.typesys import Stores, get_typestore

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_names import ENTITIES_TOPIC, ENTITIES_TYPE, dds_topic
from oracle_pipeline.bags.types import message_class, serialize
from sim.middleware.qos import DEFAULT, LATCHED

STRING = "std_msgs/msg/String"
TEXT = serialize(message_class(STRING)("hello"), STRING)


@dataclass
class Robot:
    """One participant with some nodes."""

    domain: int
    namespace: str = ""
    release: Stores = Stores.ROS2_HUMBLE
    writers: dict = field(default_factory=dict)  # by node and topic
    readers: dict = field(default_factory=dict)

    def __post_init__(self):
        self.participant = dds.join(self.domain)
        self.store = get_typestore(self.release)
        self._announcer = dds.RawWriter(
            self.participant, ENTITIES_TOPIC, ENTITIES_TYPE, LATCHED, self.store
        )

    def node(self, name, *, publishes=(), subscribes=(), qos=DEFAULT, msgtype=STRING):
        """Add a node and its endpoints."""
        for topic in publishes:
            self.writers[name, self.namespace + topic] = dds.RawWriter(
                self.participant, dds_topic(self.namespace + topic), msgtype, qos
            )
        for topic in subscribes:
            self.readers[name, self.namespace + topic] = dds.RawReader(
                self.participant, dds_topic(self.namespace + topic), msgtype, qos
            )
        return self

    def announce(self):
        """Publish which endpoints belong to which node, as every ROS 2 process does."""
        names = {name: None for name, _ in (*self.writers, *self.readers)}
        nodes = [
            self._type("NodeEntitiesInfo")(
                self.namespace or "/",
                name,
                self._of(self.readers, name),
                self._of(self.writers, name),
            )
            for name in names
        ]
        message = self._type("ParticipantEntitiesInfo")
        announced = message(self._gid(self.participant.guid.bytes), nodes)
        self._announcer.write(bytes(self.store.serialize_cdr(announced, ENTITIES_TYPE)))
        return self

    def _of(self, endpoints, name):
        return [
            self._gid(endpoint.guid) for (node, _), endpoint in endpoints.items() if node == name
        ]

    def _type(self, name):
        return self.store.types[f"rmw_dds_common/msg/{name}"]

    def _gid(self, guid):
        size = 24 if self.release is Stores.ROS2_HUMBLE else 16
        return self._type("Gid")(np.frombuffer(guid.ljust(size, b"\0"), dtype=np.uint8))
