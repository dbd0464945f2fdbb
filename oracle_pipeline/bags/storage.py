"""rosbags' writer of rosbag2, with what is done once a message or a topic made short.

A run has a hundred thousand small messages and sixty topics with a handful of QoS profiles: packing
a record in one go, and printing each profile once, decide what writing a bag costs. This is the one
module that uses what rosbags does not document, so its version is limited in ``pyproject.toml``.
"""

import functools
import io
import struct
from collections.abc import Sequence
from typing import Any, Literal

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
from rosbags.rosbag2.storage_mcap import McapWriter
from ruamel.yaml import YAML

from oracle_pipeline.bags import mcap_checksums

# The newest that Humble's `ros2 bag` opens; 9 turns the QoS profiles into a list it cannot parse.
METADATA_VERSION: Literal[8] = 8

_IDL = "=" * 80 + "\nIDL: "

# The head of a message: opcode, length of the rest; channel, sequence, log and publish time.
_MESSAGE, _HEAD = 0x05, struct.Struct("<BQHIQQ")
_LENGTH_FIRST = struct.Struct("<BQ")  # of any record: opcode, length of the rest
_FIELDS_SIZE = _HEAD.size - _LENGTH_FIRST.size


class _McapWriter(McapWriter):
    """A message's record is packed in one go, and every checksum is written."""

    _CHUNK_SIZE = 2**20

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append one message to the open chunk."""
        chunk, channel = self.chunk, connection.id
        self.message_start_time = min(timestamp, self.message_start_time)
        self.message_end_time = max(timestamp, self.message_end_time)
        chunk.message_start_time = min(timestamp, chunk.message_start_time)
        chunk.message_end_time = max(timestamp, chunk.message_end_time)
        self.channel_stats[channel] += 1
        chunk.msgs[channel].append((timestamp, chunk.bio.tell()))
        size = _FIELDS_SIZE + len(data)
        chunk.bio.write(_HEAD.pack(_MESSAGE, size, channel, 0, timestamp, timestamp))
        chunk.bio.write(data)
        if chunk.bio.tell() > self._CHUNK_SIZE:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Write the open chunk with its checksum."""
        start, records = self.bio.tell(), self.chunk.bio
        super().close_chunk()
        mcap_checksums.write_of_chunk(self.bio, start, records.getbuffer())

    def close(self, version: int, metadata: str) -> None:
        """Write what is behind the chunks, and the checksums of the two sections."""
        super().close(version, metadata)
        mcap_checksums.write_of_sections(self.path)


class Writer(RosbagsWriter):
    """Writes what rosbags writes, for connections that were added here.

    Messages are compressed by chunk or not at all.
    """

    STORAGE_PLUGINS = {**RosbagsWriter.STORAGE_PLUGINS, StoragePlugin.MCAP: _McapWriter}  # noqa: RUF012

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

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append one message."""
        self._open_storage().write(connection, timestamp, data)
        self.counts[connection.id] += 1
        self.min_timestamp = min(timestamp, self.min_timestamp)
        self.max_timestamp = max(timestamp, self.max_timestamp)

    def close(self) -> None:
        """Write what is behind the messages, and ``metadata.yaml``."""
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
    """Return a document as rosbags prints it."""
    printer = YAML(typ="safe")
    printer.default_flow_style = False
    sink = io.StringIO()
    printer.dump(value, sink)
    return sink.getvalue()
