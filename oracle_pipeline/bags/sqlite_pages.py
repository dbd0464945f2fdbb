"""Reads the messages of a damaged SQLite database from its pages, without its trees [1]_.

The page at the top of a tree is often at the end of the file. So of a file that was cut, SQLite
finds nothing, although nearly all messages are there.

References
----------
.. [1] https://www.sqlite.org/fileformat2.html
"""

from collections.abc import Iterator
from mmap import mmap
from typing import TypeAlias

from oracle_pipeline.bags.limits import LARGEST_CHUNK

_LEAF = 13  # type of a page with rows of a table
_WIDTHS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}  # bytes of an integer, by its type in a row

Bytes: TypeAlias = bytes | mmap
Row: TypeAlias = tuple[int, int, bytes]  # topic, stamp, data


def page_size(head: Bytes) -> int:
    """Return the size of a page, from the first bytes of a database."""
    size = int.from_bytes(head[16:18], "big")
    return 65_536 if size == 1 else size or 4096  # 65,536 does not fit into its two bytes


def rows_of_messages(file: Bytes) -> Iterator[Row]:
    """Yield the rows of the table of messages that are whole, in order of storage.

    Parameters
    ----------
    file : bytes or mmap
        The database.
    """
    page, last = page_size(file), -1
    leaves = (
        (_number(file, _number(file, cells[0])[1])[0], cells)
        for begin in range(page, len(file) - page + 1, page)
        if file[begin] == _LEAF and (cells := _cells(file, begin, page))
    )
    for _, cells in sorted(leaves):
        for at in cells:
            number, row = _row(file, at, page)
            if row is not None and number > last:  # a page that is no longer used has old rows
                last = number
                yield row


def _cells(file: Bytes, begin: int, page: int) -> list[int]:
    """Return where the rows of a page begin."""
    count = int.from_bytes(file[begin + 3 : begin + 5], "big")
    places = file[begin + 8 : begin + min(8 + 2 * count, page)]
    return [begin + int.from_bytes(places[n : n + 2], "big") for n in range(0, len(places), 2)]


def _number(data: Bytes, at: int) -> tuple[int, int]:
    """Return a number of variable length and its end; it has at most nine bytes."""
    value = 0
    for place, byte in enumerate(data[at : at + 9]):
        if place == 8:
            return value << 8 | byte, at + 9
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + place + 1
    return value, at + 9


def _row(file: Bytes, at: int, page: int) -> tuple[int, Row | None]:
    """Return the number of a row, and the row if it is whole and of a message."""
    size, at = _number(file, at)
    number, at = _number(file, at)
    content = _content(file, at, size, page) if size <= LARGEST_CHUNK else b""
    end, at = _number(content, 0)
    kinds = []
    while at < min(end, 64):
        kind, at = _number(content, at)
        kinds.append(kind)
    if len(content) < size or len(kinds) != 4 or kinds[0] != 0 or kinds[3] < 12 or kinds[3] % 2:
        return number, None
    values = []
    for kind in kinds[1:3]:
        width = _WIDTHS.get(kind, 0)
        value = int.from_bytes(content[at : at + width], "big", signed=True)
        values.append(value if width else kind - 8)  # types 8 and 9 are 0 and 1
        at += width
    return number, (values[0], values[1], content[at : at + (kinds[3] - 12) // 2])


def _content(file: Bytes, at: int, size: int, page: int) -> bytes:
    """Return the bytes of a row, with those on further pages, as far as these exist."""
    usable = page - file[20]
    if size <= usable - 35:
        return file[at : at + size]
    least = (usable - 12) * 32 // 255 - 23
    local = least + (size - least) % (usable - 4)
    local = local if local <= usable - 35 else least
    parts, at, missing = [file[at : at + local]], at + local, size - local
    while missing > 0:
        begin = (int.from_bytes(file[at : at + 4], "big") - 1) * page
        if not 0 < begin <= len(file) - page:
            break
        parts.append(file[begin + 4 : begin + min(usable, 4 + missing)])
        at, missing = begin, missing - usable + 4
    return b"".join(parts)
