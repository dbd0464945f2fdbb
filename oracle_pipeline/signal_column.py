"""Signals on disk: one column of a table, in each row the values in the order of its names.

A recording has thousands of statistics of signals. As columns of their own, their names and
declarations alone would take 3 MB in the footer of a table with one row. They are the same for all
rows, so the column's metadata hold them once, compressed.
"""

import base64
import functools
import json
import zlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyarrow as pa

COLUMN = "signals"
_LARGEST_NAMES = 64 * 2**20  # bytes of names and declarations, decompressed


class Unpacked(NamedTuple):
    """The signals of a table."""

    names: list[str]
    fields: dict[str, dict[str, str]]  # declarations by name
    values: NDArray[np.float64]  # shape (n_rows, n_names)


def packed(values: NDArray[np.float64]) -> "pa.FixedSizeListArray":
    """Return the signals of a table, an array of shape (n_rows, n_names), as one column."""
    import pyarrow as pa

    return pa.FixedSizeListArray.from_arrays(pa.array(np.ravel(values)), values.shape[1])


def named(names: Sequence[str], fields: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return the metadata of the column: the names of its values, with their declarations."""
    text = json.dumps({name: dict(fields.get(name, {})) for name in names})
    return {COLUMN: base64.b64encode(zlib.compress(text.encode())).decode()}


def unpacked(column: "pa.ChunkedArray", metadata: Mapping[bytes, bytes] | None) -> Unpacked:
    """Return the signals in a column of `packed`, with the metadata of `named`.

    Raises
    ------
    ValueError
        It has no names, or another number of values than names in some row.
    """
    about = (metadata or {}).get(COLUMN.encode())
    if about is None:
        raise ValueError("its signals have no names, as in tables of an older release")
    fields = _declarations(about)
    lengths = {length for part in column.chunks for length in part.value_lengths().to_pylist()}
    if lengths - {len(fields)}:
        raise ValueError("rows have different signals")
    values = np.empty((len(fields), len(column)))  # signal by signal, as pandas keeps them
    rows = [np.asarray(part.flatten()).reshape(-1, len(fields)) for part in column.chunks]
    np.concatenate([values.T[:0], *rows], out=values.T)
    return Unpacked(
        list(fields), {name: field for name, field in fields.items() if field}, values.T
    )


@functools.lru_cache(maxsize=16)  # most runs of a robot have the same
def _declarations(blob: bytes) -> dict[str, dict[str, Any]]:
    text = zlib.decompressobj().decompress(base64.b64decode(blob), _LARGEST_NAMES)
    declared = json.loads(text)
    if not isinstance(declared, dict) or not all(isinstance(f, dict) for f in declared.values()):
        raise ValueError("the names of its signals are not an object")
    return declared
