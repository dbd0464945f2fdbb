"""Writes and compares the checksums (CRC-32) of an MCAP file that rosbags leaves empty.

That of a chunk is written with it, by ``batch_storage``.

MCAP has three: of the records of each chunk, of the data section, and of the summary section, which
holds the topics, types and places of the chunks. A checksum of 0 says that there is none
(https://mcap.dev/spec).
"""

import struct
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

from oracle_pipeline.bags.errors import BagError

_MAGIC_SIZE = 8
_HEAD_SIZE = struct.calcsize("<BQ")  # of any record: opcode, length of the rest
_FOOTER_OPCODE = 0x02
_FOOTER = struct.Struct("<BQQQI")  # opcode, length; starts of summary and its index; checksum
_DATA_END = struct.Struct("<BQI")  # opcode, length; checksum of all before it
_CHECKSUM = struct.Struct("<I")
_AT_ONCE = 2**20  # bytes


def write_of_sections(path: Path) -> None:
    """Write the checksums of the two sections into a finished file."""
    with path.open("r+b") as file:
        footer_start, summary_start = _footer(file)[:2]
        data_end = summary_start - _DATA_END.size
        _write(file, summary_start - _CHECKSUM.size, _checksum(file, 0, data_end))
        end = footer_start + _FOOTER.size - _CHECKSUM.size
        _write(file, end, _checksum(file, summary_start, end))


def check_summary(file: BinaryIO) -> None:
    """Compare the checksum of the summary section, if it has one; leaves the file at its start.

    Raises
    ------
    BagError
        The summary is not what was written.
    """
    if file.seek(0, 2) > _FOOTER.size + _MAGIC_SIZE:
        footer_start, summary_start, checksum = _footer(file)
        end = footer_start + _FOOTER.size - _CHECKSUM.size
        if checksum and _checksum(file, summary_start, end) != checksum:
            raise BagError("its summary or the checksum of that was changed after it was written")
    file.seek(0)


def _footer(file: BinaryIO) -> tuple[int, int, int]:
    """Return where footer and summary start, and the summary's checksum: 0 if it has none.

    A file that does not end with a footer has none either: it was cut off.
    """
    start = file.seek(-_FOOTER.size - _MAGIC_SIZE, 2)
    opcode, size, summary_start, _, checksum = _FOOTER.unpack(file.read(_FOOTER.size))
    is_footer = opcode == _FOOTER_OPCODE and size == _FOOTER.size - _HEAD_SIZE
    return start, summary_start, checksum if is_footer else 0


def _checksum(file: BinaryIO, start: int, end: int) -> int:
    checksum = 0
    file.seek(start)
    for at in range(start, end, _AT_ONCE):
        checksum = crc32(file.read(min(_AT_ONCE, end - at)), checksum)
    return checksum


def _write(file: BinaryIO, at: int, checksum: int) -> None:
    file.seek(at)
    file.write(_CHECKSUM.pack(checksum))
