"""Peak memory of `oracle features` on recordings of 200 MB that are hard to read.

``python -m soak.memory [--megabytes 200] [NAME...]`` writes each recording, reads it in a separate
process, and prints the peak memory of that process beside the goal of 1 GiB. ``repetitive`` has
large scans in compressed chunks, ``scans`` has scans without compression, ``small`` has millions of
small messages with headers, and ``topics`` has thousands of topics.
"""

import argparse
import os
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from oracle_pipeline.bags.mcap import MAGIC
from oracle_pipeline.bags.types import definition, message_class, serialize

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

GOAL_MIB = 1024
_PROGRAM = "from oracle_pipeline.cli import main; main()"
_CHUNK = 4 * 2**20  # bytes before compression
_PERIOD_NS = 100_000


def main() -> None:
    """Write and measure the named recordings, or all."""
    parser = argparse.ArgumentParser(prog="python -m soak.memory", description=main.__doc__)
    parser.add_argument("names", nargs="*", default=list(RECORDINGS), metavar="NAME")
    parser.add_argument("--megabytes", type=float, default=200.0, help="size of each recording")
    arguments = parser.parse_args()
    for name in arguments.names:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}.mcap"
            RECORDINGS[name](path, int(arguments.megabytes * 1e6))
            peak_mib, code = measured(path)
            missed = "" if peak_mib <= GOAL_MIB else "  MISSED"
            print(
                f"{name:<12}{path.stat().st_size / 1e6:>7.1f} MB on disk{peak_mib:>7.0f} MiB peak, "
                f"exit code {code}{missed}",
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


def repetitive(path: Path, size: int) -> None:
    """Write identical scans of 20,000 rays, compressed."""
    _write(path, size, [("/scan", _scan(20_000))], "zstd", most_decompressed=30 * size)


def scans(path: Path, size: int) -> None:
    """Write scans of 1,080 rays, not compressed."""
    _write(path, size, [("/scan", _scan(1_080))], "")


def small(path: Path, size: int) -> None:
    """Write small messages with headers, compressed; one for 25 bytes on disk."""
    message = message_class("std_msgs/msg/Header")
    stamp = message_class("builtin_interfaces/msg/Time")
    _write(path, size, [("/h", message(stamp(1, 0), ""))], "", most_messages=size // 25)


def topics(path: Path, size: int) -> None:
    """Write scans on 5,000 topics."""
    _write(path, size, [(f"/scan{number}", _scan(90)) for number in range(5_000)], "")


def _scan(rays: int) -> object:
    stamp = message_class("builtin_interfaces/msg/Time")(1, 0)
    header = message_class("std_msgs/msg/Header")(stamp, "laser")
    ranges = np.linspace(1.0, 3.0, rays, dtype=np.float32)
    return message_class("sensor_msgs/msg/LaserScan")(
        header, -3.1, 3.1, 6.2 / rays, 0.0, 0.1, 0.1, 30.0, ranges, ranges
    )


def _write(
    path: Path,
    size: int,
    published: list[tuple[str, object]],
    compression: str,
    *,
    most_decompressed: int = 2**62,
    most_messages: int = 2**62,
) -> None:
    """Write messages on all topics in turn, until the file is large enough."""
    with path.open("wb") as sink:
        sink.write(MAGIC + _record(1, _text("ros2") + _text("")))
        for record in _described(published):
            sink.write(record)
        bodies = [serialize(message, message.__msgtype__) for _, message in published]  # type: ignore[attr-defined]
        decompressed = number = 0
        while sink.tell() < size and decompressed < most_decompressed and number < most_messages:
            chunk = bytearray()
            while len(chunk) < _CHUNK and number < most_messages:
                topic = number % len(bodies)
                stamp_ns = number * _PERIOD_NS
                head = struct.pack("<HIQQ", topic + 1, 0, stamp_ns, stamp_ns)
                chunk += _record(5, head + bodies[topic])
                number += 1
            decompressed += len(chunk)
            packed = zstd.compress(bytes(chunk)) if compression else bytes(chunk)
            span = struct.pack("<QQQI", 0, stamp_ns, len(chunk), 0)
            sink.write(
                _record(6, span + _text(compression) + struct.pack("<Q", len(packed)) + packed)
            )
        _end(sink)


def _described(published: list[tuple[str, object]]) -> Iterator[bytes]:
    msgtype = published[0][1].__msgtype__  # type: ignore[attr-defined]
    text = definition(msgtype)
    yield _record(3, struct.pack("<H", 1) + _text(msgtype) + _text("ros2msg") + _text(text))
    for number, (topic, _) in enumerate(published, 1):
        fields = struct.pack("<HH", number, 1) + _text(topic) + _text("cdr") + struct.pack("<I", 0)
        yield _record(4, fields)


def _end(sink: BinaryIO) -> None:
    sink.write(_record(0x0F, bytes(4)) + _record(2, bytes(20)) + MAGIC)


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


RECORDINGS: dict[str, Callable[[Path, int], None]] = {
    "repetitive": repetitive, "scans": scans, "small": small, "topics": topics,
}  # fmt: skip


if __name__ == "__main__":
    main()
