"""Signals on disk give the same table back, and take little room."""

import numpy as np
import pandas as pd
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
from oracle_pipeline.signal_column import packed, unpacked

NUMBERS = st.floats(allow_nan=True, allow_infinity=True, width=64)


@given(hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2), elements=NUMBERS))
def test_what_is_packed_is_unpacked(values):
    names = [f"signals./topic/field[{n}].mean" for n in range(values.shape[1])]
    fields = {names[0]: {"unit": "m", "floor": "nan"}}
    found = unpacked(packed(names, fields, values))
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


def test_rows_with_different_signals_are_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    one = {"name": "signals./a/b.mean", "declaration": "{}", "value": 1.0}
    pq.write_table(pa.table({"signals": [[one], [one, one]]}), tmp_path / "t.parquet")
    with pytest.raises(DatasetError, match="rows have different signals"):
        read_table(tmp_path / "t.parquet")
