"""Peak memory of `oracle features` and `oracle score` on recordings that are hard to read.

``python -m tools.soak.memory [--megabytes 200] [NAME...]`` makes each recording, extracts its
features as `oracle features` does and as the process of `oracle score` does that reads a recording,
and prints the peak of both beside the goal of 1 GiB.
"""

import argparse
import functools
import multiprocessing
import os
import sqlite3
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.mcap import MAGIC
from oracle_pipeline.bags.types import definition, message_class, serialize
from oracle_pipeline.scoring.isolation import WIDE_LIMITS, run_isolated
from tools.soak.peak_memory import peak_mib

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

GOAL_MIB = 1024
_PROGRAM = "from oracle_pipeline.cli import main; main()"
_CHUNK = 4 * 2**20  # bytes before compression
_PERIOD_NS = 100_000


def main() -> None:
    """Make and measure the recordings that are named, or all."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak.memory", description=main.__doc__)
    parser.add_argument("names", nargs="*", default=list(RECORDINGS), metavar="NAME")
    parser.add_argument("--megabytes", type=float, default=200.0, help="size of each recording")
    arguments = parser.parse_args()
    for name in arguments.names:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}.mcap"
            # In a new process, since the peak memory of a process begins with its parent's.
            maker = multiprocessing.get_context("spawn").Process(
                target=RECORDINGS[name], args=(path, int(arguments.megabytes * 1e6))
            )
            maker.start()
            maker.join()
            size = path.stat().st_size / 1e6
            print(f"{name:<12}{size:>7.1f} MB on disk", end="", flush=True)
            features_mib, code = measured(path)
            scored_mib, outcome = scored(path)
            missed = "  MISSED" if max(features_mib, scored_mib) > GOAL_MIB else ""
            print(
                f"{features_mib:>6.0f} MiB peak, exit code {code};{scored_mib:>6.0f} MiB in the "
                f"process of a score, {outcome}{missed}",
                flush=True,
            )


def measured(path: Path) -> tuple[float, int]:
    """Return the peak memory of a process that extracts features [MiB], and its exit code."""
    sink = os.open(os.devnull, os.O_WRONLY)
    program = [sys.executable, "-c", _PROGRAM, "features", str(path)]
    process = os.posix_spawn(
        sys.executable, program, os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, sink, 1)]
    )
    os.close(sink)
    _, status, usage = os.wait4(process, 0)
    return usage.ru_maxrss / 1024, os.waitstatus_to_exitcode(status)


def scored(path: Path) -> tuple[float, str]:
    """Return the peak memory of the process that reads a recording for a score [MiB]."""
    try:
        return run_isolated(peak_mib, path, WIDE_LIMITS), "read"
    except OracleError as error:
        return 0.0, str(error)


def scans(path: Path, size: int) -> None:
    """Write two scanners of 720 rays at 10 Hz, odometry and static transforms, not compressed."""
    _write(path, size, _two_scanners(), period_ns=33_000_000)


def scanners(path: Path, size: int) -> None:
    """Write the same with 24 scanners, each of which is compared with all others."""
    rng = np.random.default_rng(0)
    names = [f"laser{n}" for n in range(24)]
    _write(
        path,
        size,
        [("/tf_static", _mounts(names)), ("/odom", _odometry(0.0))]
        + [(f"/{name}", _scan(rng.uniform(0.5, 8.0, 720), name)) for name in names],
        period_ns=4_000_000,
    )  # fmt: skip


def database(path: Path, size: int) -> None:
    """Write the two scanners to SQLite."""
    published = _two_scanners()
    with sqlite3.connect(path) as sink:
        sink.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)"
        )
        sink.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB)"
        )
        numbers = {topic: number for number, topic in enumerate(dict(published), 1)}
        kinds = {topic: message.__msgtype__ for topic, message in published}
        sink.executemany(
            "INSERT INTO topics VALUES (?, ?, ?, 'cdr')",
            [(number, topic, kinds[topic]) for topic, number in numbers.items()],
        )
        sink.executemany(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
            ((numbers[topic], stamp_ns, data) for topic, stamp_ns, data in _stamped(
                published, size, 33_000_000)),
        )  # fmt: skip
    sink.close()


def ros1(path: Path, size: int) -> None:
    """Write the two scanners to a bag of ROS 1, compressed."""
    store = _noetic()
    published = _two_scanners()
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        connections = {
            topic: writer.add_connection(topic, message.__msgtype__, typestore=store)
            for topic, message in dict(published).items()
        }
        for topic, stamp_ns, data in _stamped(published, size, 33_000_000, _serialized_ros1):
            writer.write(connections[topic], stamp_ns, data)


def repetitive(path: Path, size: int) -> None:
    """Write identical scans of 20,000 rays, compressed."""
    alike = _scan(np.linspace(1.0, 3.0, 20_000), "laser")
    _write(path, size, [("/scan", alike)], "zstd", most_decompressed=30 * size)


def large(path: Path, size: int) -> None:
    """Write scans of 5 million rays."""
    _write(path, size, [("/scan", _scan(np.linspace(1.0, 3.0, 5_000_000), "laser"))])


def images(path: Path, size: int) -> None:
    """Write images of 6 MB, not compressed."""
    stamp = message_class("builtin_interfaces/msg/Time")(1, 0)
    header = message_class("std_msgs/msg/Header")(stamp, "camera")
    pixels = np.random.default_rng(0).integers(0, 255, 1080 * 1920 * 3, dtype=np.uint8)
    image = message_class("sensor_msgs/msg/Image")
    message = image(header, 1080, 1920, "rgb8", 0, 1920 * 3, pixels)
    _write(path, size, [("/image", message)], period_ns=33_000_000)


def clouds(path: Path, size: int) -> None:
    """Write point clouds of 130,000 points, not compressed."""
    stamp = message_class("builtin_interfaces/msg/Time")(1, 0)
    header = message_class("std_msgs/msg/Header")(stamp, "lidar")
    field = message_class("sensor_msgs/msg/PointField")
    points = np.random.default_rng(0).uniform(-20.0, 20.0, (130_000, 4)).astype("<f4")
    message = message_class("sensor_msgs/msg/PointCloud2")(
        header, 1, len(points), [field(name, 4 * i, 7, 1) for i, name in enumerate("xyz")],
        False, 16, 16 * len(points), np.frombuffer(points.tobytes(), np.uint8), True,
    )  # fmt: skip
    _write(path, size, [("/points", message)], period_ns=100_000_000)


def small(path: Path, size: int) -> None:
    """Write small messages with headers, compressed; one per 25 bytes on disk."""
    message = message_class("std_msgs/msg/Header")
    stamp = message_class("builtin_interfaces/msg/Time")
    _write(path, size, [("/h", message(stamp(1, 0), ""))], "zstd", most_messages=size // 25)


def chunk(path: Path, size: int) -> None:
    """Write the same in chunks of 125 MB."""
    message = message_class("std_msgs/msg/Header")
    stamp = message_class("builtin_interfaces/msg/Time")
    published = [("/h", message(stamp(1, 0), ""))]
    _write(path, size, published, "zstd", most_messages=size // 25, chunk_bytes=125_000_000)


def kept(path: Path, size: int) -> None:
    """Write odometry, commands and transforms, of which features keep every message; compressed."""
    twist = message_class("geometry_msgs/msg/Twist")
    vector = message_class("geometry_msgs/msg/Vector3")
    command = twist(vector(0.1, 0.0, 0.0), vector(0.0, 0.0, 0.2))
    published = [("/odom", _odometry(1.0)), ("/cmd_vel", command), ("/tf", _mounts(["wheel"]))]
    _write(path, size, published, "zstd", most_decompressed=10 * size, period_ns=1_000_000)


def topics(path: Path, size: int) -> None:
    """Write scans on 5,000 topics."""
    scan = _scan(np.linspace(1.0, 3.0, 90), "laser")
    _write(path, size, [(f"/scan{number}", scan) for number in range(5_000)])


def _two_scanners() -> list[tuple[str, Any]]:
    ranges = np.random.default_rng(0).uniform(0.5, 8.0, (64, 720))
    return (
        [("/tf_static", _mounts(["laser0", "laser1"]))]
        + [("/odom", _odometry(n / 10)) for n in range(64)]
        + [(f"/scan{n % 2}", _scan(ranges[n], f"laser{n % 2}")) for n in range(64)]
    )


def _stamped(
    published: list[tuple[str, Any]],
    size: int,
    period_ns: int,
    serialized: Callable[[Any, str], bytes] = serialize,
) -> Iterator[tuple[str, int, bytes]]:
    """Yield messages in a cycle until their total size is reached [B]."""
    bodies = [bytearray(serialized(each, each.__msgtype__)) for _, each in published]
    total = number = 0
    while total < size:
        place = number % len(bodies)
        if hasattr(published[place][1], "header"):
            struct.pack_into("<iI", bodies[place], 4, *divmod(number * period_ns, 10**9))
        yield published[place][0], number * period_ns, bytes(bodies[place])
        total += len(bodies[place])
        number += 1


@functools.cache
def _noetic() -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC)
    transforms = "geometry_msgs/TransformStamped[] transforms"
    store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    return store


def _serialized_ros1(message: Any, msgtype: str) -> bytes:
    """Return a message as ROS 1 serialises it: with sequence numbers in headers."""
    store = _noetic()

    def converted(value: Any) -> Any:
        if isinstance(value, list):
            return [converted(each) for each in value]
        if not hasattr(value, "__msgtype__"):
            return value
        fields = {name: converted(each) for name, each in vars(value).items()}
        if value.__msgtype__ == "std_msgs/msg/Header":
            fields["seq"] = 0
        return store.types[value.__msgtype__](**fields)

    return bytes(store.serialize_ros1(converted(message), msgtype))


def _scan(ranges: NDArray[np.float64], frame: str) -> object:
    stamp = message_class("builtin_interfaces/msg/Time")(1, 0)
    header = message_class("std_msgs/msg/Header")(stamp, frame)
    return message_class("sensor_msgs/msg/LaserScan")(
        header, -3.1, 3.1, 6.2 / len(ranges), 0.0, 0.1, 0.1, 30.0, ranges.astype(np.float32),
        np.zeros(0, dtype=np.float32),
    )  # fmt: skip


def _odometry(x: float) -> object:
    stamp = message_class("builtin_interfaces/msg/Time")(1, 0)
    header = message_class("std_msgs/msg/Header")(stamp, "odom")
    vector = message_class("geometry_msgs/msg/Vector3")
    turn = message_class("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0)
    pose = message_class("geometry_msgs/msg/Pose")(
        message_class("geometry_msgs/msg/Point")(x, 0.0, 0.0), turn
    )
    twist = message_class("geometry_msgs/msg/Twist")(vector(1.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    return message_class("nav_msgs/msg/Odometry")(
        header, "base_link",
        message_class("geometry_msgs/msg/PoseWithCovariance")(pose, np.zeros(36)),
        message_class("geometry_msgs/msg/TwistWithCovariance")(twist, np.zeros(36)),
    )  # fmt: skip


def _mounts(frames: list[str]) -> object:
    stamp = message_class("builtin_interfaces/msg/Time")(1, 0)
    header = message_class("std_msgs/msg/Header")(stamp, "base_link")
    turn = message_class("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0)
    transform = message_class("geometry_msgs/msg/Transform")
    stamped = message_class("geometry_msgs/msg/TransformStamped")
    vector = message_class("geometry_msgs/msg/Vector3")
    return message_class("tf2_msgs/msg/TFMessage")(
        [stamped(header, each, transform(vector(0.1, 0.0, 0.2), turn)) for each in frames]
    )


def _write(
    path: Path,
    size: int,
    published: list[tuple[str, Any]],
    compression: str = "",
    *,
    most_decompressed: int = 2**62,
    most_messages: int = 2**62,
    period_ns: int = _PERIOD_NS,
    chunk_bytes: int = _CHUNK,
) -> None:
    """Write messages in a cycle until the file is large enough.

    Those with a header are stamped with the time at which they are recorded.
    """
    numbers = {topic: number for number, topic in enumerate(dict(published), 1)}
    with path.open("wb") as sink:
        sink.write(MAGIC + _record(1, _text("ros2") + _text("")))
        for record in _described(numbers, dict(published)):
            sink.write(record)
        bodies = [bytearray(serialize(each, each.__msgtype__)) for _, each in published]
        stamped = [hasattr(each, "header") for _, each in published]
        decompressed = number = 0
        while sink.tell() < size and decompressed < most_decompressed and number < most_messages:
            records = []
            held = 0
            while held < chunk_bytes and number < most_messages:
                place = number % len(bodies)
                stamp_ns = number * period_ns
                if stamped[place]:
                    struct.pack_into("<iI", bodies[place], 4, *divmod(stamp_ns, 10**9))
                head = struct.pack("<HIQQ", numbers[published[place][0]], 0, stamp_ns, stamp_ns)
                records.append(_record(5, head + bodies[place]))
                held += len(records[-1])
                number += 1
            decompressed += held
            data = b"".join(records)
            packed = zstd.compress(data) if compression else data
            span = struct.pack("<QQQI", 0, stamp_ns, len(data), 0)
            sink.write(
                _record(6, span + _text(compression) + struct.pack("<Q", len(packed)) + packed)
            )
        _end(sink)


def _described(numbers: dict[str, int], published: dict[str, Any]) -> Iterator[bytes]:
    msgtypes = sorted({message.__msgtype__ for message in published.values()})
    for schema, msgtype in enumerate(msgtypes, 1):
        text = _text(definition(msgtype))
        yield _record(3, struct.pack("<H", schema) + _text(msgtype) + _text("ros2msg") + text)
    for topic, number in numbers.items():
        ids = struct.pack("<HH", number, 1 + msgtypes.index(published[topic].__msgtype__))
        yield _record(4, ids + _text(topic) + _text("cdr") + struct.pack("<I", 0))


def _end(sink: BinaryIO) -> None:
    sink.write(_record(0x0F, bytes(4)) + _record(2, bytes(20)) + MAGIC)


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


RECORDINGS: dict[str, Callable[[Path, int], None]] = {
    each.__name__: each
    for each in (
        scans, scanners, database, ros1, repetitive, large, images, clouds, small, chunk, kept,
        topics,
    )
}  # fmt: skip


if __name__ == "__main__":
    main()
