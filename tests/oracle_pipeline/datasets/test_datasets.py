import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.bootstrap import bootstrap, distinct_runs
from oracle_pipeline.datasets import (
    DatasetError,
    content_hash,
    feature_columns,
    feature_dataset,
    feature_floors,
    is_malicious,
    read_table,
    replacing,
    write_table,
)
from tests.oracle_pipeline.datasets.synthetic import FIELDS, run_features

CAMPAIGN = run_features(runs=3)


def each_run(table):
    return [table.iloc[[i]].reset_index(drop=True) for i in range(len(table))]


def changed(table, **columns):
    return table.assign(**{name.replace("__", "."): value for name, value in columns.items()})


@settings(max_examples=10)
@given(st.permutations(each_run(CAMPAIGN)))
def test_the_order_of_runs_does_not_matter(tables):
    joined = feature_dataset(tables)
    pd.testing.assert_frame_equal(joined, feature_dataset(each_run(CAMPAIGN)))
    assert list(joined["run_id"]) == sorted(CAMPAIGN["run_id"])
    assert joined.attrs["fields"] == FIELDS


def test_columns_are_found_by_family():
    structural = feature_columns(CAMPAIGN, ["structural"])
    assert structural == ["structural.density", "structural.entropy"]
    assert feature_floors(CAMPAIGN) == {"structural.density": 1e-4, "contextual.duration": 0.1}


def test_a_floor_may_be_a_share_of_the_usual_value():
    rates = pd.DataFrame({"generic.message_rate": [700.0, 720.0, np.nan, 40.0]})
    for share, floor in (("0.05", 35.0), ("0.0", 1.0)):
        declared = {"unit": "1/s", "floor": "1.0", "share": share}
        rates.attrs["fields"] = {"generic.message_rate": declared}
        assert feature_floors(rates) == {"generic.message_rate": floor}


def test_a_feature_that_a_run_lacks_is_nan_if_there_is_a_reason():
    first, second = each_run(CAMPAIGN)[:2]
    second = second.drop(columns="structural.entropy")
    second["missing"] = '{"structural.entropy": "ValueError: no graph"}'
    joined = feature_dataset([first, second])
    assert joined["structural.entropy"].isna().sum() == 1


FIRST, SECOND, *_ = each_run(CAMPAIGN)
REDECLARED = changed(SECOND)
REDECLARED.attrs["fields"] = {**FIELDS, "contextual.duration": {"unit": "ns", "floor": "1"}}


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ([], "no run features to join"),
        ([FIRST, FIRST], r"lidar_passthrough\|run000 are in more than one"),
        ([FIRST, SECOND.drop(columns="structural.entropy")], "run001 lacks.*structural.entropy"),
        ([FIRST, SECOND.drop(columns="block")], "lacks the columns block"),
        ([FIRST, changed(SECOND, session=None)], "'session' is empty.*run001"),
        ([FIRST, changed(SECOND, label="unknown")], "'unknown' of.*run001 is not one of"),
        ([FIRST, changed(SECOND, structural__density="0.02")], "'structural.density'.*not float64"),
        ([FIRST, REDECLARED], "'contextual.duration'.*'ns'.*elsewhere.*'s'"),
    ],
)
def test_inconsistent_tables_are_an_error_with_the_run(tables, said):
    with pytest.raises(DatasetError, match=said):
        feature_dataset(tables)


def test_a_table_survives_parquet_with_its_units(tmp_path):
    path = tmp_path / "datasets" / "features.parquet"
    write_table(CAMPAIGN, path)
    back = read_table(path)
    pd.testing.assert_frame_equal(back, CAMPAIGN)
    assert back.attrs == CAMPAIGN.attrs
    assert pq.read_schema(path).field("contextual.duration").metadata[b"unit"] == b"s"
    assert content_hash(back) == content_hash(CAMPAIGN)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_selected_columns_and_rows_equal_those_of_the_whole_table(tmp_path):
    path = tmp_path / "features.parquet"
    write_table(CAMPAIGN, path)
    left_out = feature_columns(CAMPAIGN)[::2]
    columns = [column for column in CAMPAIGN.columns if column not in left_out]
    runs = CAMPAIGN["run_id"][::2]
    some = read_table(path, without=left_out, runs=runs)
    expected = CAMPAIGN.loc[CAMPAIGN["run_id"].isin(runs), columns]
    pd.testing.assert_frame_equal(some, expected.reset_index(drop=True))
    assert some.attrs["fields"] == {c: FIELDS[c] for c in columns if c in FIELDS}
    assert read_table(path, runs=[]).empty


def test_any_changed_value_changes_the_content_hash():
    hashes = {content_hash(CAMPAIGN)}
    for column in CAMPAIGN.columns:
        other = CAMPAIGN.copy()
        value = other.at[4, column]
        other.at[4, column] = value + "x" if isinstance(value, str) else value + 1
        hashes.add(content_hash(other))
    assert len(hashes) == 1 + len(CAMPAIGN.columns)


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "table.parquet"
    path.write_bytes(b"old")

    def write_half():
        with replacing(path) as sink:
            sink.write(b"ne")
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_half()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_leftovers_of_a_killed_writer_are_removed_by_the_next_one(tmp_path):
    path = tmp_path / "table.parquet"
    path.with_name(".table.parquet.0badcafe").write_bytes(b"ha")  # and then: kill -9
    other = tmp_path / ".table.0badcafe"
    other.touch()
    with replacing(path) as sink:
        sink.write(b"whole")
    assert sorted(tmp_path.iterdir()) == [other, path]


def test_the_file_of_an_active_writer_is_not_removed(tmp_path):
    path = tmp_path / "table.parquet"
    with replacing(path) as sink:
        sink.write(b"first")
        with replacing(path) as another:
            another.write(b"second")
        assert path.read_bytes() == b"second"
    assert path.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_not_a_table_is_an_error_with_its_name(tmp_path):
    with pytest.raises(DatasetError, match=r"There is no table .*absent\.parquet"):
        read_table(tmp_path / "absent.parquet")
    (tmp_path / "text.parquet").write_text("no parquet")
    with pytest.raises(DatasetError, match=r"text\.parquet is not a Parquet table"):
        read_table(tmp_path / "text.parquet")


@settings(max_examples=30)
@given(st.integers(1, 400), st.floats(0.0, 1.0), st.integers(0, 2**32))
def test_a_bootstrap_has_its_size_and_rate_and_only_existing_runs(n, rate, seed):
    rows = bootstrap(CAMPAIGN, n, rate, seed)
    assert len(rows) == n
    assert is_malicious(rows).sum() == round(n * rate)
    merged = rows.merge(CAMPAIGN, how="left", indicator=True)
    assert (merged["_merge"] == "both").all()
    pd.testing.assert_frame_equal(rows, bootstrap(CAMPAIGN, n, rate, seed))


def test_distinct_runs_count_every_row_once():
    rows = bootstrap(CAMPAIGN, 500, 0.3, seed=1)
    runs = distinct_runs(rows)
    assert len(runs) == rows["run_id"].nunique()
    assert runs.copies.sum() == 500
    assert runs.copies[runs.malicious].sum() == 150
    for first, copies in zip(runs.first, runs.copies, strict=True):
        assert (rows["run_id"] == rows["run_id"][first]).sum() == copies


@pytest.mark.parametrize(
    ("wanted", "rate", "said"),
    [
        ("normal", 0.3, "no malicious run to draw 3 rows"),
        ("malicious", 0.3, "no normal run to draw 7 rows"),
        ("normal", 1.5, "malicious rate of 1.5"),
    ],
)
def test_the_error_for_a_missing_class_names_it(wanted, rate, said):
    with pytest.raises(DatasetError, match=said):
        bootstrap(CAMPAIGN[CAMPAIGN["label"] == wanted], 10, rate, seed=0)


def test_a_class_that_is_not_drawn_from_may_be_missing():
    normal = CAMPAIGN[CAMPAIGN["label"] == "normal"]
    assert np.unique(bootstrap(normal, 10, 0.0, seed=0)["label"]) == ["normal"]
