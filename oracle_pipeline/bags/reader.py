"""Read bags, whoever recorded them: rosbag2 (SQLite, MCAP, split, compressed) and ROS 1.

rosbags reads the storage. Here are: one view of a topic whatever the format, errors that say what
to do, message types from the bag itself, and the check that everything claimed was read. What a
mode's node confesses about its attack is dropped, by topic name and by type; ``read_ground_truth``
is the one way to see it.
"""

from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any, NamedTuple, Self

import yaml
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
    Qos,
)
from rosbags.rosbag1 import Reader as Reader1
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags import types
from oracle_pipeline.bags.content import ContentHash
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.qos_profiles import remember_profiles
from oracle_pipeline.bags.storage import Reader as Reader2
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE, TypeDefinition

remember_profiles()

_SEPARATOR = "=" * 80 + "\n"  # between the files of a definition


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
    count: int  # messages the bag claims to hold
    qos: tuple[Qos, ...]  # offered, one per publisher where known


class BagReader:
    """A bag opened for reading, without ground truth; a context manager.

    Parameters
    ----------
    path : Path
        Folder of a rosbag2, a single ``.mcap`` or ``.db3`` file, or a ROS 1 ``.bag`` file.

    Attributes
    ----------
    topics : dict of str to Topic
        What was recorded, by name.
    start_ns, end_ns : int
        Stamps of the first and the last message [ns]; both 0 if there is none.
    message_count : int
        Messages on ``topics``.
    serialization : {"cdr", "ros1"}
        What the bytes of a message are.

    Raises
    ------
    BagError
        If it is missing, not a bag, truncated, corrupt, or of a format that rosbags cannot read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._storage = _open(path)
        self.serialization = "ros1" if isinstance(self._storage, Reader1) else "cdr"
        connections = [c for c in self._storage.connections if not _is_ground_truth(c)]
        self._connections = connections
        self.topics = _topics(path, connections)
        self.message_count = sum(topic.count for topic in self.topics.values())
        empty = self._storage.message_count == 0
        self.start_ns: int = 0 if empty else self._storage.start_time
        self.end_ns: int = 0 if empty else self._storage.end_time - 1
        self._types = _BagTypes(path, connections, self.serialization)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield messages in time order (of a split bag: file by file).

        Parameters
        ----------
        topics : collection of str, optional
            Only these; by default all. Names that are not in the bag are ignored.

        Raises
        ------
        BagError
            If a message cannot be read, or, at the end, if a topic had not as many messages as
            the bag claims.
        """
        wanted = [c for c in self._connections if topics is None or c.topic in topics]
        return _read(self._storage, wanted, self.path)

    def deserialize(self, message: RawMessage) -> Any:
        """Decode a message, by the definition in the bag or else by the one that we know.

        Raises
        ------
        BagError
            If its type is unknown, or its bytes are not of that type.
        """
        msgtype = self.topics[message.topic].msgtype
        decode = self._types.decoder(msgtype)
        try:
            return decode(message.data, msgtype)
        except Exception as error:  # whatever the generated decoder trips over
            raise BagError(
                f"{self.path}: a message on {message.topic} at {message.stamp_ns} ns is not a "
                f"{msgtype}: {error}. Leave the topic out, or record the bag again."
            ) from error

    def definition(self, msgtype: str) -> TypeDefinition:
        """Return what the bag says of a type, or else we, to copy its messages as they are."""
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
        self._storage.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def read_ground_truth(path: Path) -> list[tuple[int, Any]]:
    """Return what the attacking node confessed: stamps [ns] and ``GroundTruth`` messages."""
    with _opened(path) as storage:
        connections = [c for c in storage.connections if _is_ground_truth(c)]
        return [
            (message.stamp_ns, types.deserialize(message.data, GROUND_TRUTH_TYPE))
            for message in _read(storage, connections, path)
        ]


def content_hash(path: Path) -> str:
    """Return the hash that ``BagWriter.content_hash`` had when the bag was written.

    Messages of a bag are read in time order, so it is the writer's order if that was too.
    """
    digest = ContentHash()
    with _opened(path) as storage:
        prefixes = {c.topic: ContentHash.prefix(c.topic, c.msgtype) for c in storage.connections}
        for topic, stamp_ns, data in _read(storage, storage.connections, path):
            digest.add(prefixes[topic], stamp_ns, data)
    return digest.hexdigest()


def _is_ground_truth(connection: Connection) -> bool:
    return connection.topic == GROUND_TRUTH_TOPIC or connection.msgtype == GROUND_TRUTH_TYPE


# Opening and reading: rosbags underneath, its many ways to fail turned into one.


def _open(path: Path) -> Reader1 | Reader2:
    try:
        if not path.exists():
            raise BagError(f"There is no bag {path}; check the path.")
        if path.is_dir():
            _check_metadata(path)
        reader = Reader1(path) if path.suffix == ".bag" else Reader2(path)
        reader.open()
    except BagError:
        raise
    except Exception as error:  # parsers of corrupt files raise anything
        raise BagError(
            f"Could not open the bag {path}: {_text(error)}. If the recording was cut off, repair "
            "it with `ros2 bag reindex` or `mcap recover`."
        ) from error
    return reader


@contextmanager
def _opened(path: Path) -> Iterator[Reader1 | Reader2]:
    reader = _open(path)
    try:
        yield reader
    finally:
        reader.close()


def _check_metadata(folder: Path) -> None:
    """Refuse a folder that is no rosbag2, and one whose metadata points out of it."""
    file = folder / "metadata.yaml"
    if not file.is_file():
        raise BagError(
            f"{folder} is not a bag: it has no metadata.yaml. Name the bag's own folder or its "
            ".mcap or .db3 file, or make the metadata with `ros2 bag reindex`."
        )
    try:
        metadata = yaml.load(file.read_text("utf-8"), Loader=yaml.CSafeLoader)
        names = list(metadata["rosbag2_bagfile_information"]["relative_file_paths"])
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError) as error:
        raise BagError(
            f"{file} is not the metadata of a rosbag2: {_text(error)}. Make it again with "
            "`ros2 bag reindex`."
        ) from error
    for name in names:
        inside = (folder / PurePosixPath(str(name)).name).resolve()
        parts = PurePosixPath(str(name)).parts
        if ".." in parts or "/" in parts or inside.parent != folder.resolve():
            raise BagError(
                f"{file} names {name!r}, which is outside the bag's folder; such a bag is not read."
            )


def _topics(path: Path, connections: list[Connection]) -> dict[str, Topic]:
    """Join the connections of a topic: ROS 1 has one for each publisher."""
    topics: dict[str, Topic] = {}
    for connection in connections:
        name = connection.topic
        qos: tuple[Qos, ...] = ()
        if isinstance(connection.ext, ConnectionExtRosbag2):
            qos = tuple(connection.ext.offered_qos_profiles)
        known = topics.get(name, Topic(name, connection.msgtype, 0, ()))
        if known.msgtype != connection.msgtype:
            raise BagError(
                f"{path} holds {name} as {known.msgtype} and as {connection.msgtype}; "
                "split it into two bags."
            )
        topics[name] = Topic(
            name, known.msgtype, known.count + connection.msgcount, known.qos + qos
        )
    return topics


def _read(
    storage: Reader1 | Reader2, connections: Collection[Connection], path: Path
) -> Iterator[RawMessage]:
    """Yield the messages of some connections, and compare their numbers with those claimed."""
    if not connections:  # rosbags would take that for "all"
        return
    claimed = Counter[str]()
    for connection in connections:
        claimed[connection.topic] += connection.msgcount
    read = Counter[str]()
    stream = _translated(storage.messages(connections), path)
    for connection, stamp_ns, data in stream:
        read[connection.topic] += 1
        yield RawMessage(connection.topic, stamp_ns, data)
    for topic, count in claimed.items():
        if read[topic] != count:
            raise BagError(
                f"{path}: {topic} should have {count} messages, but {read[topic]} were read. "
                "Perhaps metadata.yaml belongs to another recording or was edited (rosbags skips "
                "topics whose QoS profiles differ between it and the storage): make it again with "
                "`ros2 bag reindex`, or name the .mcap or .db3 file itself."
            )


def _translated(
    stream: Iterator[tuple[Connection, int, bytes]], path: Path
) -> Generator[tuple[Connection, int, bytes], None, None]:
    while True:
        try:
            item = next(stream)
        except StopIteration:
            return
        except Exception as error:  # parsers of corrupt files raise anything
            raise BagError(
                f"{path} is corrupt: {_text(error)}. Repair it with `ros2 bag reindex` or "
                "`mcap recover`, or record it again."
            ) from error
        yield item


def _text(error: Exception) -> str:
    return str(error).rstrip(".") or type(error).__name__


class _BagTypes:
    """The message types of one bag: its own definitions first, then those that we know."""

    def __init__(self, path: Path, connections: list[Connection], serialization: str) -> None:
        self._path = path
        self._is_ros1 = serialization == "ros1"  # headers and times differ from ROS 2's
        self._definitions = {c.msgtype: c.msgdef for c in connections}
        self._hashes = {c.msgtype: c.digest for c in connections}
        self._own = get_typestore(Stores.EMPTY)
        self._decoders: dict[str, Callable[[bytes, str], Any]] = {}

    def decoder(self, msgtype: str) -> Callable[[bytes, str], Any]:
        """Return the function that decodes a type's bytes."""
        if msgtype not in self._decoders:
            store = self.store(msgtype)
            self._decoders[msgtype] = (
                store.deserialize_ros1 if self._is_ros1 else store.deserialize_cdr
            )
        return self._decoders[msgtype]

    def definition(self, msgtype: str) -> TypeDefinition:
        """Return what the bag says of a type, or else we."""
        form, text = self._definitions[msgtype]
        if not text and msgtype in types.typestore().fielddefs:
            return TypeDefinition(types.definition(msgtype), types.type_hash(msgtype))
        if form is MessageDefinitionFormat.IDL and not text.startswith(_SEPARATOR):
            text = f"{_SEPARATOR}IDL: {msgtype}\n{text}"  # without it, IDL is taken for .msg
        return TypeDefinition(text, self._hashes[msgtype])

    def store(self, msgtype: str) -> Typestore:
        """Return the store that defines a type."""
        definition = self._definitions[msgtype]
        known = msgtype in types.typestore().fielddefs
        # Real bags hold an empty text for action types, whose files rosbag2 does not find.
        if known and definition.data in ("", types.definition(msgtype)):
            return types.typestore()
        if definition.data:
            try:
                self._own.register(_parse(definition, msgtype))
            except Exception as error:  # a definition is a foreign text
                raise BagError(
                    f"{self._path} has an unusable definition of {msgtype}: {_text(error)}. "
                    "Its messages can only be read raw."
                ) from error
            return self._own
        if known:
            return types.typestore()
        raise BagError(
            f"{self._path} has messages of type {msgtype} but not its definition, and it is not "
            "among the types we know: read them raw, add the definition to "
            "oracle_pipeline/bags/msg, or record as MCAP, which keeps definitions."
        )


def _parse(definition: MessageDefinition, msgtype: str) -> Any:
    if definition.format is MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, msgtype)
    found: dict[str, Any] = {}
    for part in definition.data.split(_SEPARATOR):
        # rosbag2 puts "IDL: <name>" above each file of a definition; plain IDL has no such line.
        text = part.partition("\n")[2] if part.startswith("IDL: ") else part
        if text.strip():
            found.update(get_types_from_idl(text))
    return found
