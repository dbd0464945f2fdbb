"""Files as other recorders write them, byte by byte: MCAP with any option, old SQLite schemas."""

import sqlite3
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import lz4.frame
from backports import zstd
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_typestore

from oracle_pipeline.bags.types import definition

STRING = "std_msgs/msg/String"
MAGIC = b"\x89MCAP0\r\n"
COMPRESS = {"": lambda data: data, "zstd": zstd.compress, "lz4": lz4.frame.compress}

Message = tuple[str, int, bytes]  # topic, stamp [ns], data


@dataclass(frozen=True)
class McapOptions:
    """Options in which writers of MCAP differ."""

    chunk_bytes: int = 1000  # 0: unchunked, as rosbag2's `fastwrite`
    compression: str = ""
    checksums: bool = True
    summary: bool = True
    statistics: bool = True
    repeat_channels: bool = True
    message_index: bool = True
    compress_messages: bool = False
    finished: bool = True


def write_mcap(path: Path, messages: Sequence[Message], options: McapOptions) -> list[int]:
    """Write strings; return where in the file each message was complete."""
    topics = list(dict.fromkeys(topic for topic, _, _ in messages))
    numbers = {topic: number for number, topic in enumerate(topics, start=1)}
    schema = _record(3, _u(2, 1) + _text(STRING) + _text("ros2msg") + _text(definition(STRING)))
    channels = {
        topic: _record(
            4, _u(2, number) + _u(2, 1) + _text(topic) + _text("cdr")
            + _block(_text("offered_qos_profiles") + _text("")),
        )
        for topic, number in numbers.items()
    }  # fmt: skip
    out = bytearray(MAGIC + _record(1, _text("ros2") + _text("a test")))
    chunk, held, known = bytearray(), [], set()
    complete: list[int] = []
    indexes: list[bytes] = []

    def close_chunk() -> None:
        if not chunk:
            return
        stamps = [stamp for _, stamp, _ in held] or [0]
        packed = COMPRESS[options.compression](bytes(chunk))
        begin = len(out)
        head = struct.pack(
            "<QQQI", min(stamps), max(stamps), len(chunk),
            zlib.crc32(chunk) if options.checksums else 0,
        )  # fmt: skip
        out.extend(_record(6, head + _text(options.compression) + _u(8, len(packed)) + packed))
        complete.extend([len(out)] * len(held))
        size, offsets = len(out) - begin, b""
        if options.message_index:
            for topic in dict.fromkeys(topic for topic, _, _ in held):
                offsets += struct.pack("<HQ", numbers[topic], len(out))
                entries = b"".join(
                    struct.pack("<QQ", stamp, at) for name, stamp, at in held if name == topic
                )
                out.extend(_record(7, _u(2, numbers[topic]) + _block(entries)))
        indexes.append(
            _record(
                8, struct.pack("<QQQQ", min(stamps), max(stamps), begin, size) + _block(offsets)
                + _u(8, 0) + _text(options.compression)
                + struct.pack("<QQ", len(packed), len(chunk)),
            )
        )  # fmt: skip
        chunk.clear()
        held.clear()

    for topic, stamp, data in messages:
        sink = chunk if options.chunk_bytes else out
        if not known:
            sink += schema
        if topic not in known:
            sink += channels[topic]
            known.add(topic)
        held.append((topic, stamp, len(sink)))
        sink += _message(numbers[topic], stamp, COMPRESS["zstd"](data)
                         if options.compress_messages else data)  # fmt: skip
        if not options.chunk_bytes:
            complete.append(len(out))
        elif len(chunk) > options.chunk_bytes:
            close_chunk()
    if options.chunk_bytes and options.finished:
        close_chunk()
    if options.finished:
        out += _record(15, _u(4, 0))
        start = len(out) if options.summary else 0
        if options.summary:
            out += schema + b"".join(channels.values()) if options.repeat_channels else b""
            out += b"".join(indexes)
            if options.statistics:
                out += _statistics(messages, numbers, len(indexes))
        out += _record(2, struct.pack("<QQI", start, 0, 0)) + MAGIC
    path.write_bytes(out)
    return complete


@dataclass(frozen=True)
class McapChannel:
    """A channel of an MCAP file, with all its messages."""

    topic: str
    msgtype: str
    definition: str | bytes
    data: Sequence[bytes]
    definition_format: str | None = "ros2msg"  # None: no schema
    encoding: str = "cdr"
    metadata: Mapping[str, str] = field(default_factory=dict)
    stamps_ns: Sequence[int] = ()  # by default 1, 2, ...


def write_channels(path: Path, channels: Sequence[McapChannel], more: bytes = b"") -> None:
    """Write channels of any type and encoding, not chunked, and further records."""
    out = bytearray(MAGIC + _record(1, _text("") + _text("a test")))
    for number, channel in enumerate(channels, start=1):
        text = channel.definition
        text = text.encode() if isinstance(text, str) else text
        if channel.definition_format is not None:
            names = _text(channel.msgtype) + _text(channel.definition_format)
            out += _record(3, _u(2, number) + names + _block(text))
        schema = number if channel.definition_format is not None else 0
        pairs = b"".join(_text(key) + _text(value) for key, value in channel.metadata.items())
        names = _text(channel.topic) + _text(channel.encoding)
        out += _record(4, _u(2, number) + _u(2, schema) + names + _block(pairs))
        stamps_ns = channel.stamps_ns or range(1, len(channel.data) + 1)
        for stamp, data in zip(stamps_ns, channel.data, strict=True):
            out += _message(number, stamp, data)
    out += more + _record(15, _u(4, 0)) + _record(2, bytes(20)) + MAGIC
    path.write_bytes(out)


def attachment() -> bytes:
    """Return an attachment and metadata, as records."""
    names = _text("f.txt") + _text("text/plain")
    content = struct.pack("<QQ", 1, 1) + names + _u(8, 3) + b"abc" + bytes(4)
    return _record(9, content) + _record(12, _text("about") + _block(b""))


def write_db3(
    path: Path, messages: Sequence[Message], schema: int = 3, types: Mapping[str, str] | None = None
) -> None:
    """Write a database of Foxy (1), Galactic and Humble (3), or Iron and later (4).

    Messages are strings, unless ``types`` has their topics.
    """
    qos = "" if schema < 2 else ", offered_qos_profiles TEXT NOT NULL"
    more = "" if schema < 4 else ", type_description_hash TEXT NOT NULL"
    database = sqlite3.connect(path)
    database.executescript(f"""
        CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
          serialization_format TEXT NOT NULL{qos}{more});
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
          timestamp INTEGER NOT NULL, data BLOB NOT NULL);
        CREATE INDEX timestamp_idx ON messages (timestamp ASC);
    """)
    if schema >= 3:
        database.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT)")
        database.execute("INSERT INTO schema VALUES (?, 'a test')", (schema,))
    if schema >= 4:
        database.execute(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, "
            "encoding TEXT, encoded_message_definition TEXT, type_description_hash TEXT)"
        )
        database.execute(
            "INSERT INTO message_definitions VALUES (1, ?, 'ros2msg', ?, 'RIHS01_0')",
            (STRING, definition(STRING)),
        )
    topics = list(dict.fromkeys(topic for topic, _, _ in messages))
    for number, topic in enumerate(topics, start=1):
        msgtype = (types or {}).get(topic, STRING)
        values = [number, topic, msgtype, "cdr", "", "RIHS01_0"][
            : 4 + (schema >= 2) + (schema >= 4)
        ]
        places = ",".join("?" * len(values))
        database.execute(f"INSERT INTO topics VALUES ({places})", values)  # noqa: S608
    database.executemany(
        "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
        [(topics.index(topic) + 1, stamp, data) for topic, stamp, data in messages],
    )
    database.commit()
    database.close()


def write_ros1(path: Path, messages: Sequence[Message], compression: str = "") -> None:
    """Write a ROS 1 bag of strings; data is CDR and is converted."""
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    with writer:
        connections = {
            topic: writer.add_connection(topic, STRING, typestore=store)
            for topic in dict.fromkeys(topic for topic, _, _ in messages)
        }
        for topic, stamp, data in messages:
            writer.write(connections[topic], stamp, store.cdr_to_ros1(data, STRING))


def _statistics(messages: Sequence[Message], numbers: dict[str, int], chunks: int) -> bytes:
    counts = [[topic for topic, _, _ in messages].count(topic) for topic in numbers]
    stamps = [stamp for _, stamp, _ in messages] or [0]
    head = struct.pack(
        "<QHIIIIQQ", len(messages), 1, len(numbers), 0, 0, chunks, min(stamps), max(stamps)
    )
    pairs = zip(numbers.values(), counts, strict=True)
    return _record(11, head + _block(b"".join(struct.pack("<HQ", *pair) for pair in pairs)))


def _message(channel: int, stamp: int, data: bytes) -> bytes:
    return _record(5, struct.pack("<HIQQ", channel, 0, stamp, stamp) + data)


def _record(opcode: int, data: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(data)) + data


def _u(size: int, value: int) -> bytes:
    return value.to_bytes(size, "little")


def _block(data: bytes) -> bytes:
    return _u(4, len(data)) + data


def _text(text: str) -> bytes:
    return _block(text.encode())
