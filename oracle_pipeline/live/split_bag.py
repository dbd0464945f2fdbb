"""A rosbag2 that is readable up to its last flush, however its writer ends.

Messages are in MCAP files, which follow one another as those of ``ros2 bag record --max-bag-size``.
A flush ends the open chunk and waits for the disk. If the disk is full, the file is cut after the
last flush and finished there.
"""

import contextlib
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from oracle_pipeline.bags import types
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.storage import METADATA_VERSION, Information, Writer, write_metadata
from oracle_pipeline.bags.unfinished import finish_mcap

_BATCH_BYTES = 2**18  # of messages are packed and stored at a time
_SECOND_NS = 1_000_000_000


class Split(NamedTuple):
    """When a file of a bag ends and the next one begins; None is never."""

    size_bytes: int | None = None
    seconds: float | None = None  # of the recording


class Message(NamedTuple):
    """A message to be written."""

    topic: str
    stamp_ns: int
    data: bytes


class SplitBag:
    """Writes messages into the files of a new bag.

    Parameters
    ----------
    folder : Path
        Of the bag; it must not exist.
    split : Split

    Raises
    ------
    OSError
        By any method, if nothing can be written any more. `close` then saves what was flushed.
    """

    def __init__(self, folder: Path, split: Split) -> None:
        folder.mkdir(parents=True)
        self.counts: Counter[str] = Counter()
        self._folder, self._split = folder, split
        self._topics: dict[str, tuple[str, list[Qos]]] = {}
        self._pending: list[Message] = []
        self._pending_bytes = 0
        self._ended: list[Information] = []  # of the files that are complete
        self._begun = 0  # number of files so far
        self._file = self._next()

    def add_topic(self, name: str, msgtype: str, qos: Sequence[Qos]) -> None:
        """Announce a topic, or more publishers of it."""
        self.counts[name] += 0
        self._topics.setdefault(name, (msgtype, []))[1].extend(qos)

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a message."""
        self._pending.append(Message(topic, stamp_ns, data))
        self._pending_bytes += len(data)
        if self._pending_bytes > _BATCH_BYTES:
            self._store()

    def flush(self) -> None:
        """Write all messages to the disk, and begin the next file if this one is due."""
        self._store()
        self._file.flush()
        if self._file.is_due(self._split):
            self.cut()

    def cut(self) -> None:
        """End this file, and begin the next."""
        self._store()
        self._ended.append(self._file.close_file())
        write_metadata(self._folder, self._ended)
        self._file = self._next()

    def forget(self, files: int, lead: Sequence[Message]) -> None:
        """Delete the oldest complete files, and let messages in their place lead the bag."""
        for told in self._ended[:files]:
            (self._folder / told["relative_file_paths"][0]).unlink()
            for topic in told["topics_with_message_count"]:
                self.counts[topic["topic_metadata"]["name"]] -= topic["message_count"]
        del self._ended[:files]
        if lead:
            current, self._file = self._file, self._next()
            self._pending.extend(lead)
            self._store()
            self._ended.insert(0, self._file.close_file())
            self._file = current
        write_metadata(self._folder, self._ended)

    def close(self) -> None:
        """Write the rest, and ``metadata.yaml``; after an error, what was flushed."""
        try:
            self.flush()
            for topic, described in self._topics.items():
                self._file.connect(topic, *described)
            self._ended.append(self._file.close_file())
        except OSError:
            with contextlib.suppress(BagError, OSError):  # no message, or no space for the summary
                self._ended.append(self._file.cut())
        if self._ended:
            with contextlib.suppress(OSError):  # readers do without
                write_metadata(self._folder, self._ended)

    def _next(self) -> "_File":
        self._begun += 1
        return _File(self._folder / f"{self._folder.name}_{self._begun - 1}")

    def _store(self) -> None:
        pending, self._pending, self._pending_bytes = self._pending, [], 0
        if pending:
            for topic, described in self._topics.items():  # silent ones too, if it is killed
                self._file.connect(topic, *described)
            self._file.store(pending)
            self.counts.update(topic for topic, _, _ in pending)


class _File(Writer):
    """One file of the bag; its path has no suffix."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)
        self.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._channels: dict[str, int] = {}
        self.open()

    def open(self) -> None:
        """Open for writing: rosbags makes a folder of its own, of which only the file is used."""
        super().open()
        storage = self._open_storage()
        storage.path = storage.path.rename(self.path.with_suffix(".mcap"))
        self.path.rmdir()
        storage.bio.flush()
        self._flushed = storage.bio.tell()

    def connect(self, topic: str, msgtype: str, qos: Sequence[Qos]) -> None:
        """Prepare a topic for its first message in the file."""
        if topic not in self._channels:
            text, type_hash = types.definition(msgtype), types.type_hash(msgtype)
            self._channels[topic] = self.add_topic(topic, msgtype, text, type_hash, qos).id

    def store(self, messages: Sequence[tuple[str, int, bytes]]) -> None:
        """Append messages."""
        topics, stamps_ns, payloads = zip(*messages, strict=True)
        self.write_many([self._channels[topic] for topic in topics], stamps_ns, payloads)

    def flush(self) -> None:
        """End the chunk, and wait for the disk."""
        storage = self._open_storage()
        if storage.chunk.bio.tell():
            storage.close_chunk()
            storage.bio.flush()
            os.fdatasync(storage.bio.fileno())
            self._flushed = storage.bio.tell()

    def is_due(self, split: Split) -> bool:
        """Return whether the file is as large or as long as it may be."""
        if not sum(self.counts.values()):
            return False
        seconds = (self.max_timestamp - self.min_timestamp) / _SECOND_NS
        return (split.size_bytes is not None and self._flushed >= split.size_bytes) or (
            split.seconds is not None and seconds >= split.seconds
        )

    def cut(self) -> Information:
        """Drop what was not flushed, and finish the file in its place."""
        path = self._open_storage().path
        with contextlib.suppress(OSError):
            self.abort()
        os.truncate(path, self._flushed)
        return finish_mcap(path)
