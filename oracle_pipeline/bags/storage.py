"""rosbags' writer of rosbag2, with less work for each message and topic.

A run has a hundred thousand small messages and sixty topics with a handful of QoS profiles: packing
messages in batches (``batch_storage``), and formatting each profile once, saves most of the time.
These two modules use what rosbags does not document, so its version is limited in
``pyproject.toml``.
"""

import functools
from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal

import yaml
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
    Qos,
)
from rosbags.rosbag2 import StoragePlugin, WriterError
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.metadata import dump_qos_v8

from oracle_pipeline.bags.batch_storage import BatchMcapWriter, BatchSqlite3Writer

# The newest that Humble's `ros2 bag` opens; 9 turns the QoS profiles into a list it cannot parse.
METADATA_VERSION: Literal[8] = 8

_IDL = "=" * 80 + "\nIDL: "


class Writer(RosbagsWriter):
    """Writes what rosbags writes, for connections that were added here.

    Messages are compressed by chunk or not at all.
    """

    STORAGE_PLUGINS = {  # noqa: RUF012
        StoragePlugin.MCAP: BatchMcapWriter,
        StoragePlugin.SQLITE3: BatchSqlite3Writer,
    }

    def open(self) -> None:
        """Open for writing."""
        super().open()
        self._profiles: dict[int, str] = {}  # QoS as text, by connection

    def add_topic(
        self, topic: str, msgtype: str, definition: str, type_hash: str, qos: Sequence[Qos]
    ) -> Connection:
        """Add a topic, in CDR."""
        storage = self._open_storage()
        form = (
            MessageDefinitionFormat.IDL
            if definition.startswith(_IDL)
            else MessageDefinitionFormat.MSG
        )
        connection = Connection(
            len(self.connections) + 1, topic, msgtype, MessageDefinition(form, definition),
            type_hash, 0, ConnectionExtRosbag2("cdr", list(qos)), self,
        )  # fmt: skip
        if msgtype not in self.added_types:
            storage.add_msgtype(connection)
            self.added_types.add(msgtype)
        self._profiles[connection.id] = _dumped(tuple(qos))
        storage.add_connection(connection, self._profiles[connection.id])
        self.connections.append(connection)
        self.counts[connection.id] = 0
        return connection

    def write_many(
        self, channels: Sequence[int], stamps: Sequence[int], payloads: Sequence[bytes]
    ) -> None:
        """Append messages: the identifiers of their connections, their stamps [ns], their bytes."""
        self._open_storage().write_many(channels, stamps, payloads)
        for channel, number in Counter(channels).items():
            self.counts[channel] += number
        self.min_timestamp = min(self.min_timestamp, *stamps)
        self.max_timestamp = max(self.max_timestamp, *stamps)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append one message; many at a time are cheaper."""
        self.write_many([connection.id], [timestamp], [bytes(data)])

    def close(self) -> None:
        """Write the records after the messages, and ``metadata.yaml``."""
        storage = self._open_storage()
        information = self._information(storage.path.name)
        storage.close(METADATA_VERSION, _yaml(information).strip())
        self.storage = None
        unfinished = self.metapath.with_suffix(".yaml.tmp")
        unfinished.write_text(_yaml({"rosbag2_bagfile_information": information}), "utf8")
        unfinished.replace(self.metapath)

    def _open_storage(self) -> Any:
        if self.storage is None:
            raise WriterError("the bag is not open")
        return self.storage

    def _information(self, file: str) -> dict[str, Any]:
        start = {"nanoseconds_since_epoch": self.min_timestamp}
        duration = {"nanoseconds": max(0, self.max_timestamp - self.min_timestamp)}
        count = sum(self.counts.values())
        return {
            "version": METADATA_VERSION,
            "storage_identifier": self.storage_plugin.name.lower(),
            "relative_file_paths": [file],
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": connection.topic,
                        "type": connection.msgtype,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": self._profiles[connection.id],
                        "type_description_hash": connection.digest,
                    },
                    "message_count": self.counts[connection.id],
                }
                for connection in self.connections
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [
                {
                    "path": file,
                    "starting_time": dict(start),
                    "duration": dict(duration),
                    "message_count": count,
                }
            ],
            "custom_data": None,
            "ros_distro": "rosbags",
        }


@functools.lru_cache(maxsize=1024)
def _dumped(profiles: tuple[Qos, ...]) -> str:
    return str(dump_qos_v8(list(profiles)))


def _yaml(value: dict[str, Any]) -> str:
    """Return a document as rosbags prints it, in a third of the time that ruamel takes."""
    return str(yaml.dump(value, Dumper=yaml.CSafeDumper, default_flow_style=False))
