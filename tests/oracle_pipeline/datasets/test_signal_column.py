"""Signals on disk give the same table back, and take little room."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.datasets import (
    DatasetError,
    Fields,
    content_hash,
    field_metadata,
    read_table,
    write_table,
)
from oracle_pipeline.signal_column import named, packed, unpacked

NUMBERS = st.floats(allow_nan=True, allow_infinity=True, width=64)


@given(hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2), elements=NUMBERS))
def test_what_is_packed_is_unpacked(values):
    names = [f"signals./topic/field[{n}].mean" for n in range(values.shape[1])]
    fields = {names[0]: {"unit": "m", "floor": "nan"}}
    metadata = {k.encode(): v.encode() for k, v in named(names, fields).items()}
    parts = [packed(part) for part in (values[:1], values[1:])]
    found = unpacked(pa.chunked_array(parts), metadata)
    assert found.names == names
    assert found.fields == fields
    np.testing.assert_array_equal(found.values, values)


def table(signals: int) -> pd.DataFrame:
    names = [f"signals./topic/field[{n}].mean" for n in range(signals)]
    columns = {"run_id": ["a"], "a.b": [1.0], **{name: [0.5] for name in names}, "where": ["{}"]}
    df = pd.DataFrame(columns)
    df.attrs["fields"] = Fields({name: {"unit": "m", "floor": "nan"} for name in ("a.b", *names)})
    return df


def test_table_with_signals_is_read_as_it_was_written(tmp_path):
    df = table(30)
    write_table(df, tmp_path / "t.parquet")
    again = read_table(tmp_path / "t.parquet")
    pd.testing.assert_frame_equal(again, df)
    assert field_metadata(again) == field_metadata(df)
    assert content_hash(again) == content_hash(df)


def test_thousands_of_signals_take_less_than_forty_bytes_each(tmp_path):
    write_table(table(3000), tmp_path / "t.parquet")
    assert (tmp_path / "t.parquet").stat().st_size < 3000 * 40


def test_names_are_stored_once_for_all_rows(tmp_path):
    one, many = table(3000), pd.concat([table(3000)] * 50, ignore_index=True)
    many.attrs["fields"] = one.attrs["fields"]
    write_table(one, tmp_path / "one.parquet")
    write_table(many, tmp_path / "many.parquet")
    sizes = [(tmp_path / f"{name}.parquet").stat().st_size for name in ("one", "many")]
    assert sizes[1] < 1.5 * sizes[0]  # equal values compress to nothing, and nothing else is added


@pytest.mark.parametrize(
    ("row", "names", "fault"),
    [
        ([[1.0], [1.0, 2.0]], ["signals./a/b.mean"], "rows have different signals"),
        ([[1.0], None], ["signals./a/b.mean"], "rows have different signals"),
        ([[1.0], [1.0]], ["a", "b"], "rows have different signals"),
        ([[1.0], [1.0]], None, "no names, as in tables of an older release"),
    ],
)
def test_signals_that_do_not_fit_their_names_are_refused(tmp_path, row, names, fault):
    about = None if names is None else named(names, {})
    schema = pa.schema([pa.field("signals", pa.list_(pa.float64()), metadata=about)])
    pq.write_table(pa.table({"signals": row}, schema), tmp_path / "t.parquet")
    with pytest.raises(DatasetError, match=fault):
        read_table(tmp_path / "t.parquet")
