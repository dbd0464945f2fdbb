"""rosbags' writer of rosbag2, with less work for each message and topic.

A run has a hundred thousand small messages and sixty topics with a handful of QoS profiles: packing
messages in batches (``batch_storage``), and formatting each profile once, saves most of the time.
These two modules use what rosbags does not document, so its version is limited in
``pyproject.toml``.
"""

import functools
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

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

Information: TypeAlias = dict[str, Any]  # what ``metadata.yaml`` tells of a file or a bag


class BagFile(NamedTuple):
    """One file of a bag."""

    name: str
    first_ns: int  # stamp of its first message
    last_ns: int


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
        write_metadata(self.path, [self.close_file()])

    def close_file(self) -> Information:
        """Write the records after the messages; return what ``metadata.yaml`` tells of the file."""
        storage = self._open_storage()
        told = information(
            self.storage_plugin.name.lower(),
            BagFile(storage.path.name, self.min_timestamp, self.max_timestamp),
            [(each, self._profiles[each.id], self.counts[each.id]) for each in self.connections],
        )
        storage.close(METADATA_VERSION, as_yaml(told).strip())
        self.storage = None
        return told

    def _open_storage(self) -> Any:
        if self.storage is None:
            raise WriterError("the bag is not open")
        return self.storage


def information(
    storage: str, file: BagFile, topics: Iterable[tuple[Connection, str, int]]
) -> Information:
    """Return what ``metadata.yaml`` tells of one file: its topics, their QoS and counts."""
    start = {"nanoseconds_since_epoch": file.first_ns}
    duration = {"nanoseconds": max(0, file.last_ns - file.first_ns)}
    listed: list[dict[str, Any]] = [
        {
            "topic_metadata": {
                "name": connection.topic,
                "type": connection.msgtype,
                "serialization_format": "cdr",
                "offered_qos_profiles": profiles,
                "type_description_hash": connection.digest,
            },
            "message_count": count,
        }
        for connection, profiles, count in topics
    ]
    total = sum(topic["message_count"] for topic in listed)
    return {
        "version": METADATA_VERSION,
        "storage_identifier": storage,
        "relative_file_paths": [file.name],
        "duration": duration,
        "starting_time": start,
        "message_count": total,
        "topics_with_message_count": listed,
        "compression_format": "",
        "compression_mode": "",
        "files": [
            {
                "path": file.name,
                "starting_time": dict(start),
                "duration": dict(duration),
                "message_count": total,
            }
        ],
        "custom_data": None,
        "ros_distro": "rosbags",
    }


def write_metadata(folder: Path, files: Sequence[Information]) -> None:
    """Write the ``metadata.yaml`` of a bag, from what it tells of each of its files."""
    path = folder / "metadata.yaml"
    unfinished = path.with_suffix(".yaml.tmp")
    unfinished.write_text(as_yaml({"rosbag2_bagfile_information": _joined(files)}), "utf8")
    unfinished.replace(path)


def _joined(files: Sequence[Information]) -> Information:
    if len(files) == 1:
        return files[0]
    topics: dict[str, Any] = {}
    for topic in (topic for file in files for topic in file["topics_with_message_count"]):
        name = topic["topic_metadata"]["name"]
        known = topics.setdefault(name, {**topic, "message_count": 0})
        known["message_count"] += topic["message_count"]
    rows = [row for file in files for row in file["files"]]
    spans = [
        (row["starting_time"]["nanoseconds_since_epoch"], row["duration"]["nanoseconds"])
        for row in rows
        if row["message_count"]
    ]
    start_ns = min((start for start, _ in spans), default=0)
    end_ns = max((start + duration for start, duration in spans), default=0)
    return {
        **files[0],
        "relative_file_paths": [row["path"] for row in rows],
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(row["message_count"] for row in rows),
        "topics_with_message_count": list(topics.values()),
        "files": rows,
    }


@functools.lru_cache(maxsize=1024)
def _dumped(profiles: tuple[Qos, ...]) -> str:
    return str(dump_qos_v8(list(profiles)))


def as_yaml(value: dict[str, Any]) -> str:
    """Return a document as rosbags prints it, in a third of the time that ruamel takes."""
    return str(yaml.dump(value, Dumper=yaml.CSafeDumper, default_flow_style=False))
