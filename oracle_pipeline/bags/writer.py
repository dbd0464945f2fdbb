"""Write a rosbag2, as ``ros2 bag record`` would.

rosbags writes the storage and ``metadata.yaml``; here are the hash of the content, the rule for QoS
profiles, and errors that name the bag. Nothing depends on the clock: equal calls make equal bytes.
"""

import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal, Self

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, WriterError

from oracle_pipeline.bags import types
from oracle_pipeline.bags.content import ContentHash
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.manifest import TopicCount
from oracle_pipeline.bags.storage import METADATA_VERSION, Writer
from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.bags.types import TypeDefinition

_BATCH_BYTES = 2**18  # of messages are packed, stored and hashed at a time


class _Topic:
    """A topic of the bag in progress; ``connection`` is set from its first message on."""

    __slots__ = ("channel", "connection", "count", "definition", "msgtype", "prefix", "qos")

    def __init__(self, name: str, msgtype: str, qos: list[Qos], definition: TypeDefinition) -> None:
        self.msgtype = msgtype
        self.qos = qos
        self.definition = definition
        self.prefix = ContentHash.prefix(name, msgtype)
        self.connection: Connection | None = None
        self.channel = 0  # identifier of the connection
        self.count = 0


class BagWriter:
    """Write messages into a new bag; a context manager.

    The bag appears at ``path`` when the ``with`` block ends, and not at all when it raises.

    Parameters
    ----------
    path : Path
        Folder of the bag, which must not exist. Its one file is ``<name>_0.mcap`` or ``.db3``.
    storage : {"mcap", "sqlite3"}
        MCAP is compressed by chunk with zstd. SQLite is not compressed: rosbag2 can only compress
        the whole file or each blob, and then no plain SQLite reader opens it.

    Raises
    ------
    BagError
        If the path exists, a topic is unknown or has two types, or the disk is full. The latter is
        raised by a later message, or at the end, since messages are stored in batches.

    Examples
    --------
    >>> with BagWriter(tmp_path / "bag") as bag:
    ...     bag.add_topic("/clock", "rosgraph_msgs/msg/Clock", [])
    ...     bag.write("/clock", 0, serialize(clock, "rosgraph_msgs/msg/Clock"))
    """

    def __init__(self, path: Path, storage: Literal["mcap", "sqlite3"] = "mcap") -> None:
        self.path = path
        self._hash = ContentHash()
        self._topics: dict[str, _Topic] = {}
        self._pending: list[tuple[str, int, bytes]] = []  # written, but not yet stored
        self._pending_bytes = self._stored_bytes = 0
        # rosbags names the file after the folder, rosbag2 adds "_0": so it is written as
        # "<name>_0" and the folder is renamed at the end.
        self._unfinished = path.with_name(f"{path.name}_0")
        if path.exists():
            raise BagError(f"{path} exists already; a bag is never written over another.")
        try:
            path.name.encode()
        except UnicodeEncodeError as error:
            raise BagError(
                f"{printable(str(path))} cannot be the name of a bag: metadata.yaml holds "
                "it, so it must be UTF-8. Choose another."
            ) from error
        with self._errors():
            self._writer = Writer(
                self._unfinished,
                version=METADATA_VERSION,
                storage_plugin=StoragePlugin[storage.upper()],
            )
            if storage == "mcap":
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()

    @property
    def message_bytes(self) -> int:
        """Payload bytes written so far, before compression."""
        return self._stored_bytes + self._pending_bytes

    @property
    def counts(self) -> dict[str, int]:
        """Messages written so far, by topic; topics without any included."""
        self._flush()
        return {name: topic.count for name, topic in self._topics.items()}

    @property
    def topics(self) -> dict[str, TopicCount]:
        """Type and message count of each topic so far, for the manifest."""
        self._flush()
        return {
            name: TopicCount(topic.msgtype, topic.count) for name, topic in self._topics.items()
        }

    @property
    def content_hash(self) -> str:
        """SHA-256 over (topic, type, stamp, payload) of the messages, in recorded order."""
        self._flush()
        return self._hash.hexdigest()

    def add_topic(
        self, name: str, msgtype: str, qos: Sequence[Qos], definition: TypeDefinition | None = None
    ) -> None:
        """Announce a topic, or one more publisher of it.

        Parameters
        ----------
        name, msgtype : str
            ``/scan`` and ``sensor_msgs/msg/LaserScan``.
        qos : sequence of Qos
            Profiles that the publisher offers. Those of all publishers are stored until the topic's
            first message; later ones are not in the bag, as with ``ros2 bag record``.
        definition : TypeDefinition, optional
            Definition to store; by default the built-in one, which must exist.
        """
        self._flush()  # what was written before gets the profiles offered before
        known = self._topics.get(name)
        if known is None:
            definition = definition or TypeDefinition(
                types.definition(msgtype), types.type_hash(msgtype)
            )
            self._topics[name] = _Topic(name, msgtype, list(qos), definition)
        elif known.msgtype != msgtype:
            raise BagError(
                f"{name} is of type {known.msgtype} in {self.path} and cannot also be {msgtype}; "
                "record it under another name."
            )
        elif known.connection is None:
            known.qos.extend(qos)

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append one message.

        Parameters
        ----------
        topic : str
            A topic announced with ``add_topic``.
        stamp_ns : int
            When it was received [ns].
        data : bytes
            CDR bytes, encapsulation header included.
        """
        if topic not in self._topics:
            raise BagError(f"{topic} is unknown to {self.path}; call add_topic first.")
        self._pending.append((topic, stamp_ns, data))
        self._pending_bytes += len(data)
        if self._pending_bytes > _BATCH_BYTES:
            self._flush()

    def write_many(
        self, topics: Sequence[str], stamps_ns: Sequence[int], payloads: Sequence[bytes]
    ) -> None:
        """Append messages: the topic, stamp and bytes of each, as for `write`."""
        self._flush()
        counts = Counter(topics)
        self._stored_bytes += sum(map(len, payloads))
        with self._errors():
            for name, count in counts.items():
                self._connect(name)
                self._topics[name].count += count
            channels = {name: self._topics[name].channel for name in counts}
            self._writer.write_many([channels[topic] for topic in topics], stamps_ns, payloads)
        prefixes = {name: self._topics[name].prefix for name in counts}
        self._hash.add_many([prefixes[topic] for topic in topics], stamps_ns, payloads)

    def _flush(self) -> None:
        """Pass the messages written so far to the storage and to the hash."""
        if self._pending:
            topics, stamps_ns, payloads = zip(*self._pending, strict=True)
            self._pending.clear()
            self._pending_bytes = 0
            self.write_many(topics, stamps_ns, payloads)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, raised: type[BaseException] | None, *_more: object) -> None:
        if raised is not None:
            self._discard()
            return
        try:
            self._flush()
            with self._errors():
                for name in self._topics:
                    self._connect(name)
                self._writer.close()
                self._unfinished.rename(self.path)
        except BaseException:
            self._discard()
            raise

    def _connect(self, name: str) -> None:
        """Prepare a topic for its first message, if that has not been done."""
        topic = self._topics[name]
        if topic.connection is None:
            topic.connection = self._writer.add_topic(
                name, topic.msgtype, topic.definition.text, topic.definition.type_hash, topic.qos
            )
            topic.channel = topic.connection.id

    def _discard(self) -> None:
        # Closing flushes: on a full disk it fails as the write did, whose error is raised already.
        with suppress(OSError, sqlite3.Error):
            self._writer.abort()
        shutil.rmtree(self._unfinished, ignore_errors=True)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except (OSError, sqlite3.Error, WriterError) as error:
            raise self._error(error) from error

    def _error(self, error: Exception) -> BagError:
        return BagError(
            f"Could not write the bag {self.path}: {error}. Nothing was kept of it; "
            "check free space and permissions, then record again."
        )
