"""SQLite without waiting for the disk at each event of Dagster.

Dagster opens and closes a database three times for each event. Each commit waits for the disk, and
so does each close, because the last connection to close copies the write-ahead log into the
database. Here commits do not wait, and one more connection to each database stays open, so that no
other is the last. After a power failure the newest events may be missing. No database is damaged
then, and no run is lost: runs are in files, and the next materialization verifies them.
"""

import sqlite3
from collections import OrderedDict

import sqlalchemy as sa

OPEN_DATABASES = 8  # those used last: of all runs, of events, and one for each run

_open: OrderedDict[str, sqlite3.Connection] = OrderedDict()  # by file, used last at the end


def commit_in_bulk() -> None:
    """Let all databases that this process opens from now on write in bulk."""
    if not sa.event.contains(sa.Engine, "connect", _relax):
        sa.event.listen(sa.Engine, "connect", _relax)


def _relax(connection: object, _record: object) -> None:
    if not isinstance(connection, sqlite3.Connection):
        return
    connection.execute("PRAGMA synchronous=NORMAL")
    file = next(place for _, _, place in connection.execute("PRAGMA database_list"))
    if file:  # it is not in memory
        _keep_open(file)


def _keep_open(file: str) -> None:
    kept = _open.pop(file, None) or sqlite3.connect(file, check_same_thread=False)
    kept.execute("SELECT count(*) FROM sqlite_master").fetchall()  # opens the write-ahead log
    _open[file] = kept
    if len(_open) > OPEN_DATABASES:
        _open.popitem(last=False)[1].close()
