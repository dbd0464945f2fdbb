"""Signals on disk: one column of a table, in each row a list of name, declaration and value.

A recording has thousands of statistics of signals. As columns of their own, their names and
declarations alone would take 3 MB in the footer of a table with one row.
"""

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyarrow as pa

COLUMN = "signals"


class Unpacked(NamedTuple):
    """The signals of a table."""

    names: list[str]
    fields: dict[str, dict[str, str]]  # declarations by name
    values: NDArray[np.float64]  # shape (n_rows, n_names)


def packed(
    names: Sequence[str], fields: Mapping[str, Mapping[str, str]], values: NDArray[np.float64]
) -> "pa.ListArray":
    """Return the signals of a table as one column.

    Parameters
    ----------
    names : sequence of str
    fields : mapping
        Declarations of the columns, by name.
    values : ndarray of shape (n_rows, n_names)
    """
    import pyarrow as pa

    rows = len(values)
    place = pa.array(np.tile(np.arange(len(names)), rows))
    about = [json.dumps(dict(fields.get(name, {}))) for name in names]
    parts = [pa.array(list(names)).take(place), pa.array(about).take(place)]
    structs = pa.StructArray.from_arrays(
        [*parts, pa.array(np.ravel(values))], names=["name", "declaration", "value"]
    )
    ends = np.arange(rows + 1, dtype=np.int32) * len(names)
    return pa.ListArray.from_arrays(pa.array(ends), structs)


def unpacked(column: "pa.ListArray") -> Unpacked:
    """Return the signals in a column of `packed`.

    Raises
    ------
    ValueError
        Rows have different numbers of signals.
    """
    rows, flat = len(column), column.flatten()
    count, rest = divmod(len(flat), max(rows, 1))
    if rest or any(size != count for size in np.diff(column.offsets.to_numpy())):
        raise ValueError("rows have different signals")
    names = flat.field("name").slice(0, count).to_pylist()
    about = flat.field("declaration").slice(0, count).to_pylist()
    fields = {name: json.loads(text) for name, text in zip(names, about, strict=True)}
    values = flat.field("value").to_numpy(zero_copy_only=False).reshape(rows, count)
    return Unpacked(names, {name: field for name, field in fields.items() if field}, values)
