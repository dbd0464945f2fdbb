"""Discovery on a DDS domain: ROS nodes, their publishers and subscriptions.

DDS discovers participants and endpoints. ROS 2 publishes on ``ros_discovery_info`` which of them
belong to which node. A participant that dies without a message is removed when its lease expires.
"""

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

from rosbags.typesys import Stores, get_typestore

from oracle_pipeline.bags import dds, dds_names, types
from oracle_pipeline.bags.discovery import ENTITIES_QOS, Discovery, Endpoint

_GUID = 16  # bytes; ROS 2 pads them to 24 up to Humble


class DdsDiscovery(Discovery):
    """Tracks the current state of a domain.

    Parameters
    ----------
    participant
        Ours; its own endpoints are left out.
    """

    def __init__(self, participant: dds.Participant) -> None:
        super().__init__()
        self._servers: dict[int, str] = {}  # service of each, by handle
        self._own = participant.guid.bytes
        self._builtin = dds.BuiltinReaders(participant)
        # Identifiers have 24 bytes up to Humble, and 16 later; a reader receives only its own type.
        self._stores = (types.typestore(), get_typestore(Stores.ROS2_JAZZY))
        self._entities = [
            dds.RawReader(
                participant, dds_names.ENTITIES_TOPIC, dds_names.ENTITIES_TYPE, ENTITIES_QOS, store
            )
            for store in self._stores
        ]
        self._participants: dict[int, bytes] = {}  # by handle
        self._nodes: dict[bytes, dict[str, frozenset[bytes]]] = {}  # of each participant

    def update(self) -> bool:
        """Take the newest discovery samples; return whether anything changed."""
        before = self.revision
        for sample in self._builtin.participants():
            self._participant(sample)
        for publishes, samples in (
            (True, self._builtin.publications()),
            (False, self._builtin.subscriptions()),
        ):
            for sample in samples:
                self._endpoint(sample, publishes=publishes)
        for reader, store in zip(self._entities, self._stores, strict=True):
            while raw := reader.take():
                for message in raw:
                    with contextlib.suppress(ValueError):  # names that are not UTF-8
                        self._claim(store.deserialize_cdr(message.data, dds_names.ENTITIES_TYPE))
        return self.revision != before

    def nodes(self) -> Iterator[Mapping[str, frozenset[bytes]]]:
        """Yield the nodes of each current participant, with the guids of their endpoints."""
        for participant in self._participants.values():
            yield self._nodes.get(participant, {})

    def services(self) -> frozenset[str]:
        """Return the services that have a server."""
        return frozenset(self._servers.values())

    def _participant(self, sample: dds.Discovered) -> None:
        self.revision += 1
        if sample.alive:
            self._participants[sample.handle] = sample.guid
        elif gone := self._participants.pop(sample.handle, None):
            self._nodes.pop(gone, None)

    def _endpoint(self, sample: dds.Discovered, *, publishes: bool) -> None:
        if not sample.alive:
            self.revision += self.endpoints.pop(sample.handle, None) is not None
            self._servers.pop(sample.handle, None)
            return
        if not publishes and (service := dds_names.ros_service(sample.topic)) is not None:
            self._servers[sample.handle] = service
        topic, msgtype = dds_names.ros_topic(sample.topic), dds_names.ros_type(sample.type)
        if topic is None or msgtype is None or sample.participant == self._own:
            return
        self.revision += 1
        self.endpoints[sample.handle] = Endpoint(
            sample.guid, sample.handle, sample.participant, topic, msgtype, sample.qos, publishes
        )

    def _claim(self, message: Any) -> None:
        """Take a participant's list of nodes, which replaces its former one."""
        self.revision += 1
        nodes: dict[str, frozenset[bytes]] = {}
        for node in message.node_entities_info_seq:
            name = f"{node.node_namespace.rstrip('/')}/{node.node_name}"
            own = map(_guid, (*node.reader_gid_seq, *node.writer_gid_seq))
            nodes[name] = nodes.get(name, frozenset()).union(own)
        self._nodes[_guid(message.gid)] = nodes


def _guid(gid: Any) -> bytes:
    return bytes(gid.data[:_GUID])
