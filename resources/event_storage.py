"""Dagster's SQLite storage, without waiting for the disk at each event.

Dagster opens and closes a database three times for each event, and each time SQLite writes all of
it to the disk. A campaign has ten events for each run, so that takes longer than some of its runs.
Here a connection stays open for the databases that were used last, and SQLite writes to the disk
once for many events. After a power failure the newest events may be missing. No database is
damaged then, and no run is lost: runs are in files, and the next materialization verifies them.
"""

from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sa

from resources.dagster_internals import (
    SQLITE_BUSY_TIMEOUT_SECONDS,
    ConfigurableClassData,
    DagsterSqliteStorage,
    SqliteEventLogStorage,
)

OPEN_DATABASES = 8  # the index of all runs, and one for each run


class EventStorage(SqliteEventLogStorage):
    """Dagster's event log in SQLite, with connections that stay open."""

    def __init__(self, base_dir: str) -> None:
        self._engines: OrderedDict[str, sa.Engine] = OrderedDict()  # by database, last used last
        self._tables: set[str] = set()  # known to exist
        super().__init__(base_dir)

    @contextmanager
    def _connect(self, shard: str) -> Iterator[sa.Connection]:
        with self._db_lock:
            engine = self._engine(shard)
            if shard not in self._initialized_dbs:
                self._initdb(engine)
                self._initialized_dbs.add(shard)
            with engine.begin() as connection:
                yield connection

    def _engine(self, shard: str) -> sa.Engine:
        engine = self._engines.pop(shard, None) or _engine(self.conn_string_for_shard(shard))
        self._engines[shard] = engine
        if len(self._engines) > OPEN_DATABASES:
            self._engines.popitem(last=False)[1].dispose()
        return engine

    def has_table(self, table_name: str) -> bool:
        """Return whether a table exists; Dagster asks before it stores a check's result."""
        if table_name not in self._tables and super().has_table(table_name):
            self._tables.add(table_name)
        return table_name in self._tables

    def dispose(self) -> None:
        """Close all connections."""
        for engine in self._engines.values():
            engine.dispose()
        self._engines.clear()
        super().dispose()


class WorkstationStorage(DagsterSqliteStorage):
    """Dagster's storage of a workstation: in SQLite, below ``base_dir``."""

    def __init__(self, base_dir: str, inst_data: ConfigurableClassData | None = None) -> None:
        super().__init__(base_dir, inst_data)
        self._event_log_storage = EventStorage(self._event_log_storage._base_dir)

    @classmethod
    def from_config_value(
        cls, inst_data: ConfigurableClassData | None, config_value: Any
    ) -> "WorkstationStorage":
        """Return the storage that ``dagster.yaml`` describes."""
        return cls(inst_data=inst_data, **config_value)


def _engine(url: str) -> sa.Engine:
    """Return an engine with one connection, which stays open and which all threads may use."""
    engine = sa.create_engine(
        url,
        poolclass=sa.StaticPool,
        connect_args={"timeout": SQLITE_BUSY_TIMEOUT_SECONDS, "check_same_thread": False},
    )
    sa.event.listen(engine, "connect", _write_in_bulk)
    return engine


def _write_in_bulk(connection: Any, _record: object) -> None:
    connection.execute("PRAGMA synchronous=NORMAL")
