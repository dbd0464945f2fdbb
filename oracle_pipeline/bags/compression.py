"""Bounded decompression: it stops at the declared size, or at the end of a truncated file."""

import bz2
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import LARGEST_CHUNK, LARGEST_EXPANSION

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_BLOCK = 2**20
_SMALLEST_LIMIT = 2**30  # bytes that any compressed file may become


def _lz4() -> Any:
    import lz4.frame  # its import costs more than a chunk

    return lz4.frame.LZ4FrameDecompressor()


_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor, "lz4": _lz4, "bz2": bz2.BZ2Decompressor,
}  # fmt: skip


def decompress(packed: bytes, compression: str, size: int) -> bytes:
    """Return the content of a chunk; of a truncated chunk, as much as exists.

    Parameters
    ----------
    packed
        The bytes in the file.
    compression
        ``zstd``, ``lz4`` or ``bz2``; empty or ``none`` for none.
    size
        Declared decompressed size [B]; nothing beyond it is decompressed.

    Raises
    ------
    BagError
        If the compression is unknown, or the size beyond the limit.
    Exception
        Whatever the decompressor raises on corrupt bytes.
    """
    if size > LARGEST_CHUNK:
        raise BagError(
            f"a chunk claims {size} bytes, decompressed; the limit is {LARGEST_CHUNK} "
            "(LARGEST_CHUNK)"
        )
    if compression in ("", "none"):
        return packed
    if compression not in _DECOMPRESSORS:
        raise BagError(f"chunks are compressed with {compression!r}, which is not supported")
    return _stream(packed, _DECOMPRESSORS[compression], size + 1)


def decompress_message(packed: bytes) -> bytes:
    """Return a message that was compressed individually with zstd.

    A message that only begins like compressed bytes is returned unchanged.

    Raises
    ------
    BagError
        If it becomes larger than the limit for chunks.
    """
    decompressor = zstd.ZstdDecompressor()
    try:
        message: bytes = decompressor.decompress(packed, max_length=LARGEST_CHUNK)
    except zstd.ZstdError:
        return packed
    if decompressor.eof:
        return message
    if decompressor.needs_input:
        return packed
    raise BagError(f"a message is larger than {LARGEST_CHUNK} bytes, decompressed (LARGEST_CHUNK)")


def unpacked_file(path: Path, folder: Path) -> Path:
    """Decompress a zstd file into a folder; a truncated one as far as possible.

    Raises
    ------
    BagError
        If it becomes larger than the limit for recordings.
    """
    limit = max(_SMALLEST_LIMIT, LARGEST_EXPANSION * path.stat().st_size)
    with path.open("rb") as source, tempfile.NamedTemporaryFile(dir=folder, delete=False) as sink:
        _copy(path, source, sink, limit)
    return Path(sink.name)


def _copy(path: Path, source: IO[bytes], sink: IO[bytes], limit: int) -> None:
    written = 0
    with zstd.open(source, "rb") as stream:
        while True:
            try:
                block = stream.read1(_BLOCK)
            except (EOFError, zstd.ZstdError):  # truncated or corrupt: use the part before
                return
            if not block:
                return
            written += sink.write(block)
            if written > limit or written > shutil.disk_usage(Path(sink.name).parent).free:
                raise BagError(
                    f"{path} becomes larger than {min(written, limit)} bytes when decompressed: "
                    f"more than {LARGEST_EXPANSION} times its size (LARGEST_EXPANSION), or more "
                    "than there is room for in the temporary folder. Decompress it yourself."
                )


def _stream(packed: bytes, make: Callable[[], Any], most: int) -> bytes:
    """Decompress one frame after another, at most so many bytes."""
    parts: list[bytes] = []
    while packed and most > 0:
        decompressor = make()
        rest = packed
        while most > 0 and not decompressor.eof:
            part = decompressor.decompress(rest, max_length=most)
            rest = b""
            if not part and decompressor.needs_input:
                return b"".join(parts)
            parts.append(part)
            most -= len(part)
        packed = decompressor.unused_data if decompressor.eof else b""
    return parts[0] if len(parts) == 1 else b"".join(parts)
