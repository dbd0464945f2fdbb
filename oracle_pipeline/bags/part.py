"""One file of a recording in any format, read batch by batch in file order."""

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.compression import ZSTD_MAGIC, decompress_message
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import MOST_CHANNELS
from oracle_pipeline.bags.records import Records

_READ_BYTES, _SECTOR_BYTES = 2**20, 512
_BATCH_BYTES = 32 * 2**20  # of messages that were compressed one by one


class Channel(NamedTuple):
    """One publisher or topic, as a file describes it."""

    topic: str  # as it is written in the file
    msgtype: str  # sensor_msgs/msg/LaserScan
    encoding: str  # of the messages: cdr, ros1, or one that is not supported
    definition: str  # empty: not in the file
    definition_format: str  # msg, idl, or empty
    type_hash: str
    qos: str  # YAML, or empty

    @property
    def name(self) -> str:
        """The topic's name as ROS resolves it, /scan for scan, //scan or /scan/."""
        return "/" + "/".join(part for part in self.topic.split("/") if part)


class Batch(NamedTuple):
    """Messages of a stretch of a file, in file order; one row per message."""

    data: bytes
    channels: NDArray[np.int64]  # keys of the part's channels
    stamps_ns: NDArray[np.int64]
    offsets: NDArray[np.int64]
    sizes: NDArray[np.int64]  # [B]


@dataclass(slots=True)
class Extent:
    """The content of a part, by its index or by counting."""

    counts: Counter[int] = field(default_factory=Counter)  # messages by channel
    start_ns: int | None = None
    end_ns: int | None = None
    in_order: bool = True  # no batch begins before the end of the previous one
    undated: int = 0  # messages whose stamps are negative or beyond the year 2262

    def add(self, batch: Batch) -> None:
        """Count a batch."""
        dated = np.flatnonzero(batch.stamps_ns >= 0)
        self.undated += len(batch.stamps_ns) - len(dated)
        if not len(dated):
            return
        stamps_ns = batch.stamps_ns[dated]
        first, last = int(stamps_ns.min()), int(stamps_ns.max())
        self.in_order &= self.end_ns is None or self.end_ns <= first
        self.start_ns = first if self.start_ns is None else min(self.start_ns, first)
        self.end_ns = last if self.end_ns is None else max(self.end_ns, last)
        channels, counts = np.unique(batch.channels[dated], return_counts=True)
        self.counts.update(dict(zip(channels.tolist(), counts.tolist(), strict=True)))


class Part(Protocol):
    """A file that is open for reading."""

    path: Path  # as the user knows it
    channels: dict[int, Channel]
    extent: Extent
    claims: bool  # the extent is what the file claims; it was not counted
    cut: str  # why the end could not be read; empty: it was
    unread: int  # bytes after the last message that could be read

    def batches(self, wanted: Collection[int] | None = None) -> Iterator[Batch]:
        """Yield all messages; those of other channels than the wanted ones may be left out."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


class FilePart:
    """A file of bytes that is open for reading; what parts of several formats share.

    Parameters
    ----------
    file : Path
        To read.
    path : Path
        Path for messages to the user: the same, or the compressed file that it came from.
    """

    def __init__(self, file: Path, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.extent, self.claims = Extent(), True
        self.cut, self.unread, self._is_cut = "", 0, False
        self._file: BinaryIO = file.open("rb")
        try:
            self._size = self._end = self._file.seek(0, 2)
            self._read_contents()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read_contents(self) -> None:
        """Read channels and extent."""
        raise NotImplementedError

    def _corrupt(self, what: str) -> BagError:
        """Return the error of a damaged file, with what to do next."""
        raise NotImplementedError

    def _stop(self, at: int, reason: str) -> None:
        """End reading at a byte: what follows is lost in a truncated file, and otherwise damage."""
        if not self._is_cut:
            raise self._corrupt(reason)
        self.cut, self.unread = reason, self._size - at


def written_size(file: BinaryIO) -> int:
    """Return where an unfinished file ends, without the zeros that a full disk leaves behind.

    Fewer than a sector of them may belong to the last message.
    """
    size = end = file.seek(0, 2)
    while end:
        begin = max(0, end - _READ_BYTES)
        file.seek(begin)
        block = file.read(end - begin).rstrip(b"\0")
        end = begin + len(block)
        if block:
            break
    return end if size - end >= _SECTOR_BYTES else size


def measure(part: Part) -> None:
    """Count the messages of a part."""
    part.extent = Extent()
    for batch in part.batches():
        part.extent.add(batch)
    part.claims = False


def add_channel(channels: dict[int, Channel], number: int, channel: Channel) -> None:
    """Keep a channel that a file describes, the first time."""
    channels.setdefault(number, channel)
    if len(channels) > MOST_CHANNELS:
        raise BagError(f"it has more than {MOST_CHANNELS} channels, the limit (MOST_CHANNELS)")


def unpacked(data: bytes, records: Records) -> Iterator[Batch]:
    """Yield records as a batch; messages that were compressed one by one are decompressed.

    A message in CDR begins with a zero, so it cannot begin with zstd's magic number.
    """
    batch = Batch(data, *records[:4])
    buffer = np.frombuffer(data, np.uint8)
    packed = np.zeros(len(batch.sizes), dtype=np.bool_)
    long = np.flatnonzero(batch.sizes >= len(ZSTD_MAGIC))
    packed[long] = buffer[batch.offsets[long]] == ZSTD_MAGIC[0]
    if not packed.any():
        yield batch
        return
    parts: list[bytes] = []
    first, held = 0, 0
    for row, (offset, size) in enumerate(
        zip(batch.offsets.tolist(), batch.sizes.tolist(), strict=True)
    ):
        message = data[offset : offset + size]
        if message.startswith(ZSTD_MAGIC):
            message = decompress_message(message)
        parts.append(message)
        held += len(message)
        if held >= _BATCH_BYTES:
            yield _joined(parts, batch, first)
            parts, first, held = [], row + 1, 0
    if parts:
        yield _joined(parts, batch, first)


def _joined(parts: list[bytes], batch: Batch, first: int) -> Batch:
    sizes = np.array([len(part) for part in parts], dtype=np.int64)
    rows = slice(first, first + len(parts))
    return Batch(
        b"".join(parts), batch.channels[rows], batch.stamps_ns[rows], np.cumsum(sizes) - sizes,
        sizes,
    )  # fmt: skip


def loss(part: Part) -> str:
    """Describe how much of a file could be read, and up to when."""
    read, extent = part.extent.counts.total(), part.extent
    if extent.start_ns is None or extent.end_ns is None:
        return f"{part.path.name} was not finished ({part.cut}): no message could be read."
    seconds = (extent.end_ns - extent.start_ns) / 1e9
    unread = f"; the last {part.unread} bytes could not be read" if part.unread else ""
    return (
        f"{part.path.name} was not finished ({part.cut}): {read} messages were read, up to "
        f"{extent.end_ns} ns ({_utc(extent.end_ns)}), {seconds:.1f} s after the first{unread}."
    )


def _utc(stamp_ns: int) -> str:
    try:
        return f"{datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (OverflowError, ValueError, OSError):
        return "beyond any calendar"


def ros2_name(name: str) -> str:
    """Return a type's name as ROS 2 writes it, sensor_msgs/msg/LaserScan.

    The given name may have the form of ROS 1, IDL or DDS.

    Examples
    --------
    >>> ros2_name("std_msgs/String"), ros2_name("std_msgs::msg::dds_::String_")
    ('std_msgs/msg/String', 'std_msgs/msg/String')
    """
    if "::" in name:
        name = name.removesuffix("_") if "::dds_::" in name else name
        name = name.replace("::dds_::", "/").replace("::", "/").strip("/")
    package, slash, rest = name.partition("/")
    return f"{package}/msg/{rest}" if slash and "/" not in rest else name
