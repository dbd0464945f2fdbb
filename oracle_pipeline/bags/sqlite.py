"""Read a rosbag2 in SQLite, of any schema version, even if the database was not closed.

The database itself is never opened for writing: one with a journal or a write-ahead log beside it
is copied to a temporary folder and recovered there.
"""

import itertools
import mmap
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import numpy as np

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import LARGEST_CHUNK, LARGEST_DEFINITION
from oracle_pipeline.bags.part import Batch, Channel, Extent, add_channel, ros2_name, unpacked
from oracle_pipeline.bags.records import Records
from oracle_pipeline.bags.sqlite_pages import Row, page_size, rows_of_messages

MAGIC = b"SQLite format 3\0"

_BATCH_BYTES, _BATCH_ROWS = 4 * 2**20, 10_000
_FORMATS = {"ros2msg": "msg", "ros2idl": "idl"}
_NOTHING = np.zeros(0, dtype=np.int64)
# SQLite stores values of any type in any column.
_SOUND = "typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"


class SqlitePart:
    """A ``.db3`` file; a `Part`.

    Parameters
    ----------
    file, path : Path
        File to read, and its path for messages to the user.

    Raises
    ------
    BagError
        If it is no rosbag2 database, or so damaged that its topics cannot be read.
    """

    def __init__(self, file: Path, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.extent = Extent()
        self.claims = True
        self.cut, self.unread = "", 0
        self._size = file.stat().st_size
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._database: sqlite3.Connection | None = None
        try:
            self._database = self._open(file)
            try:
                self._read_topics(self._database)
            except sqlite3.DatabaseError:
                # Without this, SQLite refuses a file that is shorter than its header says.
                self._database.execute("PRAGMA writable_schema = ON")
                self._read_topics(self._database)
            self._measure(self._database)
        except BaseException as error:
            self.close()
            if isinstance(error, sqlite3.Error):
                raise BagError(
                    f"{path} is not a database of rosbag2, or it is damaged: {error}. Try "
                    f"to recover it with `sqlite3 {path} .recover`."
                ) from error
            raise

    def close(self) -> None:
        """Close the file."""
        if self._database is not None:
            self._database.close()
        if self._folder is not None:
            self._folder.cleanup()

    def batches(self, wanted: Collection[int] | None = None) -> Iterator[Batch]:
        """Yield all messages in order of time; of a damaged database in order of storage."""
        rows = self._rows(wanted) if self.claims else self._rows_of_pages()
        try:
            while held := _next_rows(rows):
                yield from _batches(held)
        except sqlite3.DatabaseError as error:
            raise BagError(f"{self.path} is corrupt: {error}.") from error

    def _rows(self, wanted: Collection[int] | None) -> Iterator[Row]:
        assert self._database is not None  # noqa: S101 -- as long as it is open
        topics = self.channels if wanted is None else wanted
        numbers = ",".join(str(number) for number in sorted(topics))
        filtered = "" if wanted is None else f"AND topic_id IN ({numbers})"
        yield from self._database.execute(
            f"SELECT topic_id, timestamp, data FROM messages WHERE {_SOUND} {filtered} "  # noqa: S608 -- numbers only
            "ORDER BY timestamp, id"
        )

    def _rows_of_pages(self) -> Iterator[Row]:
        """Yield the messages that are whole, although the trees of the database are not."""
        with (
            self._file.open("rb") as source,
            mmap.mmap(source.fileno(), 0, access=mmap.ACCESS_READ) as file,
        ):
            yield from (row for row in rows_of_messages(file) if row[0] in self.channels)

    def _open(self, file: Path) -> sqlite3.Connection:
        """Open the database, or a copy of one that was not closed."""
        with file.open("rb") as source:
            page = page_size(source.read(18))
        if self._size % page:
            # SQLite would fill up the truncated page with zeros.
            copy = self._copy(file)
            os.truncate(copy, self._size - self._size % page)
            file = copy
        aside = [file.with_name(file.name + end) for end in ("-wal", "-journal")]
        if any(each.is_file() and each.stat().st_size for each in aside):
            copy = self._copy(file)
            for each in aside:
                if each.is_file():
                    shutil.copyfile(each, copy.with_name(copy.name + each.name[len(file.name) :]))
            database = sqlite3.connect(copy)
            self.cut = "the database was not closed; its journal or write-ahead log was read too"
            with suppress(sqlite3.DatabaseError):
                database.execute("SELECT count(*) FROM sqlite_master").fetchone()
            database.execute("PRAGMA query_only = ON")
        else:
            name = quote(str(file).encode("utf-8", "surrogateescape"))
            database = sqlite3.connect(f"file:{name}?immutable=1&mode=ro", uri=True)
        database.execute("PRAGMA trusted_schema = OFF")
        self._file = file
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_CHUNK)
        database.text_factory = lambda text: text.decode("utf-8", "replace")
        return database

    def _copy(self, file: Path) -> Path:
        self._folder = tempfile.TemporaryDirectory(prefix="oracle-")
        copy = Path(self._folder.name, "copy.db3")
        shutil.copyfile(file, copy)
        return copy

    def _read_topics(self, database: sqlite3.Connection) -> None:
        tables = {
            name
            for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        }
        if not {"topics", "messages"} <= tables:
            raise BagError(f"{self.path} is an SQLite database but no rosbag2: it has no messages.")
        definitions: dict[str, tuple[str, str, str]] = {}
        if "message_definitions" in tables:
            for msgtype, encoding, text, type_hash in database.execute(
                "SELECT topic_type, encoding, encoded_message_definition, type_description_hash "
                "FROM message_definitions WHERE length(encoded_message_definition) <= ?",
                (LARGEST_DEFINITION,),
            ):
                definitions[msgtype] = (text, _FORMATS.get(encoding, ""), type_hash)
        columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
        qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        topics = f"SELECT id, name, type, serialization_format, {qos} FROM topics ORDER BY id"  # noqa: S608 -- one of two words
        for number, name, msgtype, encoding, profiles in database.execute(topics):
            text, form, type_hash = definitions.get(msgtype, ("", "", ""))
            channel = Channel(
                str(name), ros2_name(str(msgtype)), str(encoding), text, form, type_hash,
                str(profiles),
            )  # fmt: skip
            add_channel(self.channels, number, channel)

    def _measure(self, database: sqlite3.Connection) -> None:
        """Take counts and times from the tables; count what can be read if they are damaged."""
        try:
            for number, count, first, last in database.execute(
                "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages "  # noqa: S608 -- a constant
                f"WHERE {_SOUND} AND timestamp >= 0 GROUP BY topic_id"
            ):
                self.extent.counts[number] = count
                known = self.extent.start_ns, self.extent.end_ns
                self.extent.start_ns = first if known[0] is None else min(known[0], first)
                self.extent.end_ns = last if known[1] is None else max(known[1], last)
            undated = "SELECT count(*) FROM messages WHERE timestamp < 0"
            (self.extent.undated,) = database.execute(undated).fetchone()
        except sqlite3.DatabaseError as error:
            self.cut = f"the database is damaged: {error}"
            self.claims, self.extent = False, Extent()
            for batch in self.batches():
                self.extent.add(batch)


def _next_rows(rows: Iterator[Row]) -> list[Row]:
    """Return the rows of the next batch."""
    held: list[Row] = []
    size = 0
    for row in itertools.islice(rows, _BATCH_ROWS):
        held.append(row)
        size += len(row[2])
        if size >= _BATCH_BYTES:
            break
    return held


def _batches(rows: list[Row]) -> Iterator[Batch]:
    channels, stamps_ns, messages = zip(*rows, strict=True)
    sizes = np.array([len(message) for message in messages], dtype=np.int64)
    joined = b"".join(messages)
    yield from unpacked(
        joined,
        Records(
            np.array(channels, dtype=np.int64), np.array(stamps_ns, dtype=np.int64),
            np.cumsum(sizes) - sizes, sizes, _NOTHING, len(joined),
        ),
    )  # fmt: skip
