"""The feature tables on disk: of one run, or joined for the runs of a partition.

A worker writes the tables of one run, ``run003.parquet``, and beside them ``run003.json``, a record
of what they hold. When all runs of a partition of several are over, their tables are joined in
``run000-249.parquet`` with a record of the same form: 10,000 runs are 40 files, not 10,000.
"""

import functools
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.layout import TABLES, TableName
from oracle_pipeline.bags.protocol import runs_named
from oracle_pipeline.bags.run_directory import RunDirectory

if TYPE_CHECKING:
    import pandas as pd

_Record = dict[str, dict[str, Any]]  # what is known of each run, by its name
_NOTHING = ("", 0.0, 0)


@dataclass(frozen=True, slots=True)
class KeptTables:
    """Tables of one or more runs of a mode, and the record of what they hold.

    Attributes
    ----------
    root, mode
        Where they are.
    name
        Of the runs: ``run003``, or ``run000-249``.
    runs
        Hash of the inputs and figures of the tables, by run.
    hashes
        SHA-256 of each table.
    """

    root: Path
    mode: str
    name: str
    runs: Mapping[str, Any]
    hashes: Mapping[str, str]

    def place(self, table: TableName) -> Path:
        """Return the path of one of the tables."""
        return layout.feature_table(self.root, table, self.mode, self.name)

    def is_intact(self) -> bool:
        """Return whether no table has changed since it was written."""
        return self.hashes == _hashes(self.root, self.mode, self.name)

    def record(self) -> None:
        """Write the record, after the tables."""
        from oracle_pipeline.datasets import replacing

        content = json.dumps({"runs": self.runs, "tables": self.hashes}).encode()
        with replacing(_record(self.place("run"))) as sink:
            sink.write(content)

    def remove(self) -> None:
        """Remove the tables, the record first."""
        for file in (_record(self.place("run")), *map(self.place, TABLES)):
            file.unlink(missing_ok=True)


def kept_tables(run: RunDirectory) -> KeptTables | None:
    """Return the tables with the features of a run: its own, or joined ones; None without any."""
    if own := _read(run.root, run.mode, run.run_id):
        return own
    records = run.feature_table("run").parent.glob("run*-*.json")
    names = [file.stem for file in sorted(records) if run.run in (runs_named(file.stem) or ())]
    joined = (_read(run.root, run.mode, name) for name in names)
    return next((kept for kept in joined if kept and run.run_id in kept.runs), None)


def read_tables(runs: Iterable[RunDirectory], table: TableName) -> Iterator["pd.DataFrame"]:
    """Yield the rows of runs, from each file once.

    Raises
    ------
    DatasetError
        A run has no tables, or a file is damaged.
    """
    from oracle_pipeline.datasets import read_table

    keys_of: dict[Path, list[str]] = {}
    for run in runs:
        kept = kept_tables(run)
        place = kept.place(table) if kept else run.feature_table(table)
        keys_of.setdefault(place, []).append(run.key)
    for place, keys in keys_of.items():
        yield read_table(place, runs=keys)


def keep_tables(run: RunDirectory, inputs: str, figures: Mapping[TableName, Any]) -> None:
    """Record the tables of a run, which have been written, with the hash of their inputs."""
    record = {run.run_id: {"inputs": inputs, "figures": figures}}
    _keep_record(run.root, run.mode, run.run_id, record)


def join_tables(runs: Sequence[RunDirectory], name: str) -> None:
    """Join the tables of runs of one mode in files of a name, and remove them elsewhere.

    An interrupted call leaves some rows in two places, equal ones; the next call completes it.
    """
    found = {run: kept for run in runs if (kept := kept_tables(run))}
    if not found or all(kept.name == name for kept in found.values()):
        return
    _write(found, name)
    emptied = {kept.name: kept for kept in found.values() if kept.name != name}
    for kept in emptied.values():
        of_file = [RunDirectory.of_key(kept.root, f"{kept.mode}|{run}") for run in kept.runs]
        others = [run for run in of_file if run not in found]
        if others:
            _write(dict.fromkeys(others, kept), kept.name)
        else:
            kept.remove()


def _write(found: Mapping[RunDirectory, KeptTables], name: str) -> None:
    """Write the tables of runs in files of a name, and record them."""
    from oracle_pipeline.datasets import feature_dataset, window_dataset, write_table

    root, mode = next((run.root, run.mode) for run in found)
    joined = {"run": feature_dataset, "window": window_dataset}
    for table in TABLES:
        place = layout.feature_table(root, table, mode, name)
        write_table(joined[table](read_tables(found, table)), place)
    records = {run.run_id: kept.runs[run.run_id] for run, kept in found.items()}
    _keep_record(root, mode, name, records)


def _keep_record(root: Path, mode: str, name: str, runs: Mapping[str, Any]) -> None:
    """Record tables that have been written, and what is known of their runs."""
    KeptTables(root, mode, name, runs, _hashes(root, mode, name)).record()


def _record(table: Path) -> Path:
    return table.with_suffix(".json")


def _read(root: Path, mode: str, name: str) -> KeptTables | None:
    table = layout.feature_table(root, "run", mode, name)
    place = _record(table)
    stamp = _stamp(place)
    missing = stamp == _NOTHING or not table.is_file()  # another process may have deleted it
    content = None if missing else _content(place, stamp)
    return KeptTables(root, mode, name, content["runs"], content["tables"]) if content else None


@functools.lru_cache(maxsize=64)
def _content(record: Path, _stamp: tuple[str, float, int]) -> _Record | None:
    """Return the content of a record; None if it is damaged or of an older release."""
    try:
        content = json.loads(record.read_bytes())
    except (FileNotFoundError, ValueError):
        return None
    return content if isinstance(content, dict) and content.keys() == {"runs", "tables"} else None


def _hashes(root: Path, mode: str, name: str) -> dict[str, str]:
    places = {table: layout.feature_table(root, table, mode, name) for table in TABLES}
    return {table: _sha256(place, _stamp(place)) for table, place in places.items()}


@functools.lru_cache(maxsize=64)
def _sha256(file: Path, stamp: tuple[str, float, int]) -> str:
    """Return the hash of a file, computed once for each of its states; empty without a file."""
    return "" if stamp == _NOTHING else hashlib.sha256(file.read_bytes()).hexdigest()


def _stamp(file: Path) -> tuple[str, float, int]:
    """Return what tells one state of a file from another; ``_NOTHING`` without a file."""
    try:
        status = file.stat()
    except FileNotFoundError:
        return _NOTHING
    return str(file), status.st_mtime, status.st_size
