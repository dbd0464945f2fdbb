"""Tables of run features: join, check, read and write them, with their units.

One row is one run. Features are computed in ``oracle_pipeline.features``; scaling and clustering
are in ``oracle_pipeline.clustering``. Declarations of a column (unit, resolution floor) are in the
field metadata of the Parquet schema and, in memory, in ``DataFrame.attrs["fields"]``.
"""

from __future__ import annotations  # pandas is imported only where it is used: it takes long

import hashlib
import io
import json
import math
import os
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags import seals
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import LABELS
from oracle_pipeline.bags.remote import is_local
from oracle_pipeline.bags.scratch import scratch_beside
from oracle_pipeline.signal_column import COLUMN, named, packed, unpacked

if TYPE_CHECKING:
    import pandas as pd

KEYS = ("run_id", "mode", "label", "block", "session", "world")
WINDOW_START = "window_start_s"  # further key of window tables [s of the recording]
WHERE = "where"  # the column with the topic, pair or edge at which a feature was attained
_SEAL = "oracle.seal"  # key in the metadata of a Parquet schema
MISSING = "missing"  # the column with the reason why a feature is NaN

SIGNALS = "signals."  # prefix of columns that are statistics of the signals of any robot
MINUS = " minus "  # in the name of a signal that is the difference of two numbers in messages
LAG = ".lag"  # ends the name of how late the first of the two is

HARD_NEGATIVE = "benign_"  # prefix of the names of modes with a harmless change


class DatasetError(OracleError):
    """A feature table cannot be joined, read or drawn from."""


class Fields(dict[str, dict[str, str]]):
    """The declarations of each column, shared by all tables that derive from one.

    pandas deep-copies ``attrs`` whenever a column is selected, which is slow for hundreds of
    declared columns; here that returns the same object.
    """

    def __deepcopy__(self, _memo: dict[int, object]) -> Self:
        return self


def feature_columns(df: pd.DataFrame, families: Collection[str] | None = None) -> list[str]:
    """Return the feature columns, in table order, without those of signals.

    Parameters
    ----------
    df : DataFrame
        A ``run_features`` table; features are named ``<family>.<name>``.
    families : collection of str, optional
        Only these families; by default all.
    """
    named = [column for column in _names(df) if "." in column]
    columns = [column for column in named if not column.startswith(SIGNALS)]
    if families is None:
        return columns
    return [column for column in columns if column.split(".", 1)[0] in families]


def signal_columns(df: pd.DataFrame) -> list[str]:
    """Return the columns that are statistics of signals, in table order.

    They differ between robots. Features are few and known; of signals there are hundreds.
    """
    return [column for column in _names(df) if column.startswith(SIGNALS)]


def _names(df: pd.DataFrame) -> list[str]:
    return list(map(str, df.columns.tolist()))  # the columns themselves iterate 20 times as slowly


def topic_of_signal(column: str) -> str:
    """Return the topic of a column of `signal_columns`; empty for another column.

    Examples
    --------
    >>> topic_of_signal("signals./odom/pose.pose.position.x.mean")
    '/odom'
    """
    return column.removeprefix(SIGNALS).rpartition("/")[0] if column.startswith(SIGNALS) else ""


def is_lag(signal: str) -> bool:
    """Return whether a signal is a lag behind a command; a field may be named `lag`, too.

    Examples
    --------
    >>> is_lag("x minus cmd.x.lag"), is_lag("network.lag")
    (True, False)
    """
    return MINUS in signal and signal.endswith(LAG)


def field_metadata(df: pd.DataFrame) -> dict[str, dict[str, str]]:
    """Return the declarations of each column (``unit``, ``floor``, ...); may be empty."""
    return dict(df.attrs.get("fields", {}))


def feature_floors(df: pd.DataFrame) -> dict[str, float]:
    """Return the declared resolution of features, in the feature's unit; NaN is undeclared.

    One that is declared as a share of the value is that of the median in this table.
    """
    fields = field_metadata(df)
    floors = {name: float(field.get("floor", "nan")) for name, field in fields.items()}
    shares = {name: float(field.get("share", 0.0)) for name, field in fields.items()}
    for name in (each for each, share in shares.items() if share and each in df):
        usual = float(df[name].abs().median())
        floors[name] = np.fmax(floors[name], shares[name] * usual)
    return {name: floor for name, floor in floors.items() if math.isfinite(floor)}


def is_malicious(df: pd.DataFrame) -> NDArray[np.bool_]:
    """Return a mask of the rows of attacked runs; all other labels are the negative class."""
    return np.asarray(df["label"] == "malicious", dtype=np.bool_)


def is_hard_negative(df: pd.DataFrame) -> NDArray[np.bool_]:
    """Return a mask of the rows of normal runs with a harmless change."""
    return np.asarray(df["mode"].str.startswith(HARD_NEGATIVE), dtype=np.bool_)


def without_empty_families(df: pd.DataFrame) -> pd.DataFrame:
    """Return a table without families that have no value, such as those of another system."""
    columns = feature_columns(df)
    families = {column.split(".", 1)[0] for column in columns if df[column].notna().any()}
    empty = {column for column in columns if column.split(".", 1)[0] not in families}
    kept = df[[column for column in df.columns if column not in empty]].reset_index(drop=True)
    kept.attrs["fields"] = Fields({c: f for c, f in field_metadata(df).items() if c not in empty})
    return kept


def feature_dataset(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Join the feature tables of many runs into one with a row for each run, by ``run_id``.

    A feature that a table lacks becomes NaN if the table's ``missing`` column has a reason.

    Raises
    ------
    DatasetError
        There are no tables, a key column is missing or empty, a run occurs twice, a label is
        unknown, or tables have different columns, types or units.
    """
    return _joined(tables, KEYS, "run", ["run_id"])


def window_dataset(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Join the window tables of many runs into one, sorted by ``run_id`` and window start.

    As `feature_dataset`, including errors.
    """
    return _joined(tables, (*KEYS, WINDOW_START), "window", ["run_id", WINDOW_START])


def check_runs(table: pd.DataFrame) -> None:
    """Raise an error unless a table has one row with all keys and features for each run.

    Raises
    ------
    DatasetError
        A key or a column is missing, repeated or of another type, or a label is unknown.
    """
    if not table.columns.is_unique or table["run_id"].duplicated().any():
        raise DatasetError("A table of runs has a column or a run twice; extract it again.")
    _check_keys(table, KEYS)
    _check_columns(table, [])


def _joined(
    tables: Iterable[pd.DataFrame], keys: tuple[str, ...], kind: str, order: list[str]
) -> pd.DataFrame:
    import pandas as pd

    parts = [table for table in tables if len(table)]
    if not parts:
        raise DatasetError(
            f"There are no {kind} features to join; record runs and extract features."
        )
    for part in parts:
        _check_keys(part, keys)
    parts.sort(key=lambda part: str(part["run_id"].iloc[0]))
    features = dict.fromkeys(column for part in parts for column in feature_columns(part))
    for part in parts:
        _check_columns(part, list(features))
    signals = dict.fromkeys(column for part in parts for column in signal_columns(part))
    columns = [*features, *signals]
    fields = _joined_fields(parts)
    joined = pd.concat(parts, ignore_index=True)
    parts.clear()  # they take as much memory
    others = [column for column, type_ in joined.dtypes[columns].items() if type_ != np.float64]
    joined = joined.astype(dict.fromkeys(others, np.float64)) if others else joined
    repeated = joined.loc[joined.duplicated(order), "run_id"].unique()
    if len(repeated):
        raise DatasetError(
            f"Runs {', '.join(sorted(repeated))} are in more than one feature table; "
            f"remove the stale files under features/{kind} and join again."
        )
    joined = joined[[*keys, *columns, WHERE, MISSING]]
    # The copy is in one piece, not in thousands, each to be selected alone.
    joined = joined.sort_values(order, kind="stable", ignore_index=True).copy()
    joined.attrs["fields"] = fields
    return joined


def _check_keys(table: pd.DataFrame, keys: tuple[str, ...]) -> None:
    absent = [key for key in (*keys, WHERE, MISSING) if key not in table.columns]
    if absent:
        raise DatasetError(
            f"A feature table lacks the columns {', '.join(absent)}; "
            "it was not written by the feature extraction. Extract its features again."
        )
    for key in keys:
        if table[key].isna().any():
            raise DatasetError(f"Key column {key!r} is empty in {_runs(table)}; extract it again.")
    unknown = sorted(set(table["label"]) - set(LABELS))
    if unknown:
        raise DatasetError(
            f"Label {unknown[0]!r} of {_runs(table)} is not one of {', '.join(LABELS)}; "
            "leave out runs with an unknown label."
        )


def _check_columns(table: pd.DataFrame, columns: list[str]) -> None:
    reasons = {reason for text in table[MISSING] for reason in json.loads(text)}
    absent = [column for column in columns if column not in table.columns]
    unexplained = [column for column in absent if not column.startswith(tuple(reasons))]
    if unexplained:
        raise DatasetError(
            f"{_runs(table)} lacks the features {', '.join(unexplained)}, which other runs have; "
            "extract all runs with the same plugins."
        )
    types = dict(zip(_names(table), table.dtypes.tolist(), strict=True))
    for column in (*feature_columns(table), *signal_columns(table)):
        if types[column].kind != "f":
            raise DatasetError(
                f"Feature {column!r} of {_runs(table)} is {types[column]}, not float64; "
                "extract it again."
            )


def _joined_fields(tables: list[pd.DataFrame]) -> Fields:
    joined = Fields()
    for table in tables:
        for column, field in field_metadata(table).items():
            if joined.setdefault(column, field) != field:
                raise DatasetError(
                    f"Column {column!r} of {_runs(table)} is declared as {field}, elsewhere as "
                    f"{joined[column]}; extract all runs with the same plugins."
                )
    return joined


def _runs(table: pd.DataFrame) -> str:
    shown = str(table["run_id"].iloc[0])
    return shown if len(table) == 1 else f"{shown} and {len(table) - 1} more"


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Yield a file to write; it replaces `path` once it is complete and on disk.

    Raises
    ------
    OSError
        The file cannot be written; the old one stays.
    """
    if not is_local(path):  # object stores write atomically
        whole = io.BytesIO()
        yield whole
        path.write_bytes(whole.getvalue())
        return
    try:
        with scratch_beside(path, Path.touch) as scratch:
            with scratch.open("wb") as sink:
                yield sink
                sink.flush()
                os.fsync(sink.fileno())
            scratch.replace(path)
    except OSError as error:
        if error.filename is not None or error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error  # such as a full disk


def write_table(df: pd.DataFrame, path: Path) -> None:
    """Write a table atomically as Parquet, sealed, with units in the schema."""
    content = table_bytes(df)
    with replacing(path) as sink:
        sink.write(content)


def table_bytes(df: pd.DataFrame) -> bytes:
    """Return a table as the bytes of a sealed Parquet file, with units in the schema."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields, signals = field_metadata(df), signal_columns(df)
    table = pa.table(dict(df.drop(columns=signals).items()))
    if signals:
        place = df.columns.tolist().index(signals[0])
        column = packed(df[signals].to_numpy(dtype=np.float64))
        table = table.add_column(place, COLUMN, column)
        fields |= {COLUMN: named(signals, fields)}
    schema = pa.schema([field.with_metadata(fields.get(field.name)) for field in table.schema])
    sealed = table.cast(schema).replace_schema_metadata({_SEAL: seals.BLANK})
    whole = io.BytesIO()
    # Groups are decoded one at a time, so that readers of some rows need less memory.
    pq.write_table(sealed, whole, compression="zstd", row_group_size=4096)
    content = bytearray(whole.getbuffer())
    seals.seal(content)
    return bytes(content)


def read_table(
    path: Path, *, without: Collection[str] = (), runs: Iterable[str] | None = None
) -> pd.DataFrame:
    """Read a Parquet table; ``attrs["fields"]`` describes its columns.

    Parameters
    ----------
    path : Path
        Of the file.
    without : collection of str
        Columns to leave out.
    runs : iterable of str, optional
        Only rows with these ``run_id``; by default all.

    Raises
    ------
    DatasetError
        The file is missing, is not Parquet, or was changed after `write_table` wrote it. A table
        from another program has no seal, and is not checked.
    """
    import pyarrow as pa

    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise DatasetError(
            f"There is no table {path}; materialize `feature_dataset`, or check the path."
        ) from error
    df = parse_table(content, str(path), without=without, runs=runs)
    pa.default_memory_pool().release_unused()  # which kept twice the size of the table
    return df


def parse_table(
    content: bytes, name: str, *, without: Collection[str] = (), runs: Iterable[str] | None = None
) -> pd.DataFrame:
    """Return the table from the bytes that `table_bytes` returned; errors mention `name`.

    As `read_table`, including errors.
    """
    import pandas as pd
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    kept = None
    if runs is not None:
        kept = pc.field("run_id").isin(pa.array(sorted(runs), pa.large_string()))
    if seals.check(content) == "wrong":
        raise DatasetError(
            f"{name} is damaged: it has changed since it was written. Materialize it again. If you "
            f"changed it on purpose, write it without {_SEAL!r} in the metadata of its schema."
        )
    try:
        source = pa.BufferReader(content)
        columns = [n for n in pq.read_schema(source).names if n not in without] if without else None
        table = pq.read_table(source, columns=columns, filters=kept)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DatasetError(
            f"{name} is not a Parquet table ({error}); materialize it again."
        ) from error
    fields = Fields(
        {
            field.name: {key.decode(): value.decode() for key, value in field.metadata.items()}
            for field in table.schema
            if field.metadata and field.name != COLUMN
        }
    )
    df: pd.DataFrame
    if COLUMN in table.column_names:
        place = table.column_names.index(COLUMN)
        try:
            signals = unpacked(table[COLUMN], table.field(COLUMN).metadata)
        except ValueError as error:
            raise DatasetError(f"{name} cannot be read: {error}. Make it again.") from error
        others = table.drop_columns([COLUMN]).replace_schema_metadata(None).to_pandas()
        of_signals = pd.DataFrame(signals.values, others.index, signals.names, copy=False)
        df = pd.concat([others.iloc[:, :place], of_signals, others.iloc[:, place:]], axis=1)
        fields |= signals.fields
    else:
        df = table.replace_schema_metadata(None).to_pandas()
    df.attrs["fields"] = fields
    return df


def content_hash(df: pd.DataFrame) -> str:
    """Return the SHA-256 of a table's column names and values, independent of the file."""
    import pandas as pd

    digest = hashlib.sha256()
    is_number = [pd.api.types.is_numeric_dtype(type_) for type_ in df.dtypes]
    numbers = iter(df.loc[:, is_number].to_numpy(dtype="<f8").T)  # columns one by one are slow
    for column, is_numeric in zip(_names(df), is_number, strict=True):
        digest.update(json.dumps(column).encode())
        if is_numeric:
            digest.update(next(numbers).tobytes())
        else:
            digest.update(json.dumps([str(value) for value in df[column]]).encode())
    return digest.hexdigest()
