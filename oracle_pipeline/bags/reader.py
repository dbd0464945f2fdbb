"""Read recordings of any origin: rosbag2 (SQLite, MCAP, split, compressed) and ROS 1.

The content is taken from the files themselves, not from ``metadata.yaml``. `BagReader` has the same
view of topics for every format. It yields messages in order of time or, faster, as arrays in file
order, and lists what could not be read. Ground truth about an attack is dropped, by topic name and
by type; only ``read_ground_truth`` returns it.
"""

import copy
import itertools
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Qos
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags import qos_profiles, types
from oracle_pipeline.bags.content import ContentHash
from oracle_pipeline.bags.definitions import BagTypes
from oracle_pipeline.bags.errors import BagError, as_bag_error
from oracle_pipeline.bags.limits import MOST_MESSAGES, SMALLEST_MESSAGE
from oracle_pipeline.bags.merging import Messages, in_time_order
from oracle_pipeline.bags.part import Batch, Channel, Part, loss
from oracle_pipeline.bags.parts import Parts, open_parts
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE, TypeDefinition


class RawMessage(NamedTuple):
    """One recorded message, not decoded."""

    topic: str
    stamp_ns: int  # when it was recorded [ns]
    data: bytes  # CDR with its encapsulation header; ROS 1 serialisation in a ROS 1 bag


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a bag."""

    name: str
    msgtype: str  # in the ROS 2 spelling, sensor_msgs/msg/LaserScan, for ROS 1 too
    count: int  # messages in the bag
    qos: tuple[Qos, ...]  # offered, one per publisher where known
    encoding: str = "cdr"  # of its messages: cdr, ros1, or one that is not decoded here


class BagReader:
    """A recording opened for reading, without ground truth; a context manager.

    Parameters
    ----------
    path : Path
        Folder of a rosbag2, a single ``.mcap`` or ``.db3`` file, or a ROS 1 ``.bag`` file.
    strict : bool
        Refuse a recording of which a part is missing or cannot be read.

    Attributes
    ----------
    topics : dict of str to Topic
        What was recorded, by name; the leading slash that other tools than ROS leave out is added.
    start_ns, end_ns : int
        Stamps of the first and the last message [ns]; both 0 if there is none.
    message_count : int
        Messages on ``topics``.
    serialization : {"cdr", "ros1"}
        Encoding of messages, unless a topic declares another one.
    losses : list of str
        What could not be read: the end of an unfinished file, a missing part.
    notes : list of str
        Other remarks on the recording.

    Raises
    ------
    BagError
        If it is missing, not a bag, corrupt, of a format that is not supported or beyond a limit;
        with ``strict``, also if it is incomplete.
    """

    def __init__(self, path: Path, *, strict: bool = False) -> None:
        self.path = path
        self._files = _open(path)
        parts = self._files.parts
        self.notes, self.losses = list(self._files.notes), list(self._files.losses)
        self.losses += [loss(part) for part in parts if part.cut]
        if undated := sum(part.extent.undated for part in parts):
            self.notes.append(
                f"{undated} messages were stamped before 1970 or after 2262; they are not used."
            )
        if self.losses and (strict or not any(part.extent.counts.total() for part in parts)):
            self._files.close()
            raise BagError(
                f"{path} is incomplete. {' '.join(self.losses)}"
                f"{' Without --strict, the readable part is read.' if strict else ''}"
            )
        channels = [
            (channel, part.extent.counts[number])
            for part in parts
            for number, channel in part.channels.items()
        ]
        self._used: dict[tuple[str, str], str] = {}  # name by topic and type in the files
        self.topics = self._join(channels)
        self.message_count = sum(topic.count for topic in self.topics.values())
        if not self.message_count:
            self.notes.append("It has no messages.")
        size = sum(part.path.stat().st_size for part in parts)
        self._most_messages = max(MOST_MESSAGES, size // SMALLEST_MESSAGE)
        starts = [part.extent.start_ns for part in parts if part.extent.start_ns is not None]
        ends = [part.extent.end_ns for part in parts if part.extent.end_ns is not None]
        self.start_ns: int = min(starts, default=0)
        self.end_ns: int = max(ends, default=0)
        encodings = {topic.encoding for topic in self.topics.values()}
        self.serialization = "ros1" if encodings == {"ros1"} else "cdr"
        self._types = BagTypes(path, [c for c, _ in channels], self._files.type_hashes)
        self._shown = {name: name for name in self.topics}  # what `renamed` made of the names

    def renamed(self, names: Mapping[str, str]) -> Self:
        """Return the same open bag with renamed topics; topics without a new name are left out.

        Parameters
        ----------
        names : mapping of str to str
            New name by recorded name; all new names differ.
        """
        view = copy.copy(self)
        view.topics = {
            new: replace(topic, name=new)
            for name, topic in self.topics.items()
            if (new := names.get(name)) is not None
        }
        view.message_count = sum(topic.count for topic in view.topics.values())
        view._shown = {old: names[shown] for old, shown in self._shown.items() if shown in names}
        return view

    def recorded(self, topic: str) -> str:
        """Return the name that a topic had before ``renamed``."""
        return next(old for old, shown in self._shown.items() if shown == topic)

    def batches(self, topics: Collection[str] | None = None) -> Iterator[Messages]:
        """Yield messages as arrays, in file order; stretches without any of the topics are empty.

        Parameters
        ----------
        topics : collection of str, optional
            Only these; by default all. Names that are not in the bag are ignored.

        Raises
        ------
        BagError
            If a message cannot be read, or, at the end, if a file had fewer messages than it
            claims.
        """
        numbers = {name: number for number, name in enumerate(self.topics)}
        read = 0
        for part in self._files.parts:
            wanted = {
                key: numbers[topic.name]
                for key, channel in part.channels.items()
                if (topic := self._topic_of(channel)) and (topics is None or topic.name in topics)
            }
            for batch in self._read(part, wanted, is_all=topics is None):
                read += len(batch.topics)
                if read > self._most_messages:
                    raise BagError(
                        f"{self.path} holds more than {self._most_messages} messages, the limit "
                        "for its size (MOST_MESSAGES); cut it into shorter ones."
                    )
                yield batch

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield messages in order of time.

        Messages of one stamp come in file order. The parameter and the error are those of
        ``batches``.
        """
        names = list(self.topics)
        for batch, rows in self.in_order(topics):
            for topic, stamp_ns, data in zip(
                batch.topics[rows].tolist(), batch.stamps_ns[rows].tolist(), batch.messages(rows),
                strict=True,
            ):  # fmt: skip
                yield RawMessage(names[topic], stamp_ns, data)

    def in_order(
        self, topics: Collection[str] | None = None
    ) -> Iterator[tuple[Messages, NDArray[np.int64]]]:
        """Yield messages in order of time as arrays, and rows in that order.

        Parameter, order and error are those of ``messages``.
        """
        return in_time_order(
            lambda: self.batches(topics), is_in_order=_is_in_order(self._files.parts)
        )

    def deserialize(self, message: RawMessage) -> Any:
        """Decode a message, by the definition in the bag or else by the one that we know.

        Raises
        ------
        BagError
            If its type is unknown, or its bytes are not of that type.
        """
        topic, stamp_ns, data = message
        try:
            return self.decoder(topic)(data)
        except BagError as error:
            if str(self.path) in str(error):
                raise
            raise BagError(
                f"{self.path}: a message on {topic} at {stamp_ns} ns {error}. Leave the topic out, "
                "or record the bag again."
            ) from error

    def decoder(self, topic: str) -> Callable[[bytes], Any]:
        """Return the function that decodes the messages of a topic.

        It raises `BagError` where bytes are not of the type.

        Raises
        ------
        BagError
            If its type is unknown or unusable, or its encoding not supported.
        """
        msgtype = self.topics[topic].msgtype
        decode = self._types.decoder(msgtype)

        def decoded(data: bytes) -> Any:
            try:
                return decode(data, msgtype)
            except Exception as error:  # the generated decoder may raise any error
                reason = str(error).rstrip(".") or type(error).__name__
                raise BagError(f"is not a {msgtype}: {reason}") from error

        return decoded

    def definition(self, msgtype: str) -> TypeDefinition:
        """Return a type's definition from the bag, or else the built-in one, to copy messages."""
        return self._types.definition(msgtype)

    def typestore(self, msgtype: str) -> Typestore:
        """Return the store that defines a type as the bag has it; treat it as read-only.

        Raises
        ------
        BagError
            If its definition is neither in the bag nor known to us.
        """
        return self._types.store(msgtype)

    def close(self) -> None:
        """Close the files."""
        self._files.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def _is_hidden(self, channel: Channel) -> bool:
        return channel.name == GROUND_TRUTH_TOPIC or channel.msgtype == GROUND_TRUTH_TYPE

    def _topic_of(self, channel: Channel) -> Topic | None:
        """Return the topic that a channel is read for; None if it is not used."""
        name = self._used.get((channel.topic, channel.msgtype), "")
        return self.topics.get(self._shown.get(name, ""))

    def _join(self, channels: list[tuple[Channel, int]]) -> dict[str, Topic]:
        """Join the channels of a topic: publishers of ROS 1, parts, differing QoS profiles.

        Of several types or spellings of one name, the one with most messages is used.
        """
        counts: dict[str, Counter[tuple[str, str]]] = {}
        for channel, count in channels:
            if not self._is_hidden(channel):
                counts.setdefault(channel.name, Counter())[channel.topic, channel.msgtype] += count
        topics: dict[str, Topic] = {}
        for name, by_origin in counts.items():
            (used, count), *others = by_origin.most_common()
            self.notes += [
                f"{name} was recorded as {_words(used)} and as {_words(other)}; the {number} "
                "messages of the latter are not used."
                for other, number in others
            ]
            self._used[used] = name
            own = [c for c, _ in channels if (c.topic, c.msgtype) == used]
            topics[name] = Topic(name, used[1], count, self._qos(own), own[0].encoding)
        return topics

    def _qos(self, channels: list[Channel]) -> tuple[Qos, ...]:
        texts = [channel.qos for channel in channels if channel.qos]
        texts = texts or [self._files.qos.get(channels[0].topic, "")]
        try:
            return tuple(
                profile for text in dict.fromkeys(texts) for profile in qos_profiles.parse(text)
            )
        except ValueError as error:
            self.notes.append(f"The QoS profiles of {channels[0].name} cannot be read: {error}.")
            return ()

    def _read(self, part: Part, wanted: dict[int, int], *, is_all: bool) -> Iterator[Messages]:
        """Yield a part's messages on some channels, and compare their number with its claims."""
        if not wanted:
            return
        with as_bag_error(self.path, part.path):
            keys = np.array(sorted(wanted), dtype=np.int64)
            numbers = np.array([wanted[key] for key in sorted(wanted)], dtype=np.int64)
            read = np.zeros(len(keys), dtype=np.int64)
            for batch in part.batches(None if is_all else wanted):
                places = np.minimum(np.searchsorted(keys, batch.channels), len(keys) - 1)
                rows = np.flatnonzero(keys[places] == batch.channels)
                read += np.bincount(places[rows], minlength=len(keys))
                rows = rows[batch.stamps_ns[rows] >= 0]  # others are beyond the year 2262
                yield _selected(batch, numbers[places], rows)
        if not part.claims:
            return
        for key, count in zip(keys.tolist(), read.tolist(), strict=True):
            if count < part.extent.counts[key]:
                raise BagError(
                    f"{part.path}: {part.channels[key].topic} should have "
                    f"{part.extent.counts[key]} messages, but {count} were read. The file is "
                    "damaged; copy it again, or see what `mcap recover` saves."
                )


class _OpenReader(BagReader):
    """Reads hidden topics too; refuses an incomplete bag."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, strict=True)

    def _is_hidden(self, channel: Channel) -> bool:  # noqa: ARG002 -- none is
        return False


def read_ground_truth(path: Path) -> list[tuple[int, Any]]:
    """Return the ground truth of the attacking node: stamps [ns] and ``GroundTruth`` messages."""
    with _OpenReader(path) as bag:
        topics = [t.name for t in bag.topics.values() if t.msgtype == GROUND_TRUTH_TYPE]
        return [
            (message.stamp_ns, types.deserialize(message.data, GROUND_TRUTH_TYPE))
            for message in bag.messages(topics)
        ]


def content_hash(path: Path) -> str:
    """Return the hash that ``BagWriter.content_hash`` had when the bag was written.

    Messages are read in order of time, so the hash is equal if they were written in that order.
    """
    return counts_and_hash(path)[1]


def counts_and_hash(path: Path) -> tuple[dict[str, int], str]:
    """Return the number of messages of each topic, hidden ones included, and `content_hash`."""
    digest = ContentHash()
    with _OpenReader(path) as bag:
        prefixes = [ContentHash.prefix(t.name, t.msgtype) for t in bag.topics.values()]
        for batch, rows in bag.in_order():
            digest.add_many(
                [prefixes[topic] for topic in batch.topics[rows].tolist()],
                batch.stamps_ns[rows],
                batch.messages(rows),
            )
        return {topic.name: topic.count for topic in bag.topics.values()}, digest.hexdigest()


def _words(origin: tuple[str, str]) -> str:
    """Name a topic and its type as a file has them."""
    topic, msgtype = origin
    return f"{topic} ({msgtype})"


def _selected(batch: Batch, topics: NDArray[np.int64], rows: NDArray[np.int64]) -> Messages:
    """Return some rows of a batch."""
    data, _, stamps_ns, offsets, sizes = batch
    return Messages(data, topics[rows], stamps_ns[rows], offsets[rows], sizes[rows])


def _is_in_order(parts: list[Part]) -> bool:
    """Return whether no stretch of any file begins before the end of the previous one."""
    spans = [
        (part.extent.start_ns, part.extent.end_ns)
        for part in parts
        if part.extent.start_ns is not None and part.extent.end_ns is not None
    ]
    return all(part.extent.in_order for part in parts) and all(
        end <= begin for (_, end), (begin, _) in itertools.pairwise(spans)
    )


def _open(path: Path) -> Parts:
    if not os.path.lexists(path):
        raise BagError(f"There is no bag {path}; check the path.")
    with as_bag_error(path, path):
        return open_parts(path)
