import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline import features
from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.datasets import KEYS, feature_columns, feature_dataset, read_table
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.windows import HOP_S, SHORTEST_S, WINDOW_S, windows_ns

MANAGER = features.build_manager()
SECOND = 1_000_000_000


def extract(path: Path) -> features.FeatureTables:
    with open_run(path) as run:
        return features.extract(run, MANAGER)


@given(st.integers(round(HOP_S * SECOND), 700 * SECOND))
def test_windows_cover_the_recording_each_half_window(duration_ns):
    times_ns = np.arange(0, duration_ns + 1, SECOND)
    windows = windows_ns(duration_ns + 1, times_ns)
    length_ns, hop_ns = round(WINDOW_S * SECOND), round(HOP_S * SECOND)
    assert [start for start, _ in windows] == [hop_ns * i for i in range(len(windows))]
    assert len(windows) == duration_ns // hop_ns
    for start_ns, end_ns in windows:
        assert end_ns == min(start_ns + length_ns, duration_ns + 1)
        assert end_ns - start_ns > hop_ns


@given(st.integers(1, round(HOP_S * SECOND)))
def test_short_recording_is_one_window_unless_it_is_too_short(duration_ns):
    whole = [(0, duration_ns)] if duration_ns >= SHORTEST_S * SECOND else []
    assert windows_ns(duration_ns, np.zeros(1, dtype=np.int64)) == whole


@given(st.lists(st.integers(0, 100 * SECOND), max_size=5))
def test_a_window_without_a_message_is_none(times_ns):
    held = np.array(times_ns, dtype=np.int64)
    all_windows = windows_ns(100 * SECOND, np.arange(0, 100 * SECOND, SECOND))
    assert windows_ns(100 * SECOND, held) == [
        (start, end)
        for start, end in all_windows
        if ((start <= held) & (held < start + round(WINDOW_S * SECOND))).any()
    ]


def test_tables_have_keys_of_the_manifest_and_features(make_run):
    tables = extract(make_run().path)
    for table in tables:
        assert tuple(table.columns[: len(KEYS)]) == KEYS
        assert table.columns[-2:].tolist() == ["where", "missing"]
        assert set(table["run_id"]) == {"fake_object|run003"}
        assert set(table["label"]) == {"malicious"}
        assert set(table["block"]) == {3}
        for column in feature_columns(table):
            assert table[column].dtype == np.float64
            assert table.attrs["fields"][column]["unit"]
    assert tables.windows["window_start_s"].tolist() == [2.5 * n for n in range(10)]
    assert len(tables.run) == 1


def test_every_nan_has_a_reason_and_nothing_else_has(make_run, foreign_bag):
    for path in (make_run().path, foreign_bag):
        for table in extract(path):
            for _, row in table.iterrows():
                assert not set(json.loads(row["where"])) & set(json.loads(row["missing"]))
                absent = {column for column in feature_columns(table) if pd.isna(row[column])}
                assert set(json.loads(row["missing"])) == absent


def test_a_run_of_ours_gives_every_feature_of_graphs_and_of_the_thesis(make_run):
    missing = json.loads(extract(make_run().path).run["missing"].iloc[0])
    always = {"structural", "structural_raw", "traffic", "contextual"}
    assert not always & {column.split(".")[0] for column in missing}


def test_features_do_not_depend_on_the_manifest(make_run):
    ours = extract(make_run().path)
    theirs = extract(
        make_run(
            "lidar_passthrough", 0, label="normal", onset_s=None, attack={}, recipe={}, block=9,
            session=2, world="elsewhere", recording_s=1.0, task_effect=None, outcome="succeeded",
        ).path
    )  # fmt: skip
    for mine, other in zip(ours, theirs, strict=True):
        columns = feature_columns(mine)
        pd.testing.assert_frame_equal(mine[columns], other[columns])


def test_storage_does_not_matter(make_run):
    ours, theirs = extract(make_run().path), extract(make_run(run=4, storage="sqlite3").path)
    for mine, other in zip(ours, theirs, strict=True):
        columns = feature_columns(mine)
        pd.testing.assert_frame_equal(mine[columns], other[columns])


def test_a_window_has_the_newest_graph_at_its_end(make_run):
    windows = extract(make_run().path).windows.set_index("window_start_s")
    edges = windows["structural.average_degree"]
    # Without the recorder: 4 edges and 5 vertices, in the second interval 1 edge and 2 more.
    first = dict.fromkeys((5.0, 7.5, 10.0, 12.5), 8 / 5)
    second = dict.fromkeys((15.0, 17.5), 10 / 7)
    assert edges[[0.0, 2.5]].isna().all()
    assert edges[5.0:17.5].to_dict() == pytest.approx(first | second)
    assert edges[22.5] == pytest.approx(8 / 5)


def test_a_foreign_bag_gives_what_it_can(foreign_bag):
    tables = extract(foreign_bag)
    assert tables.run["mode"].tolist() == ["foreign"]
    assert tables.run["label"].tolist() == ["unknown"]
    missing = json.loads(tables.run["missing"].iloc[0])
    assert missing["structural.density"] == "no ROS graph was recorded before the end of the window"
    assert len(tables.windows) >= 4


def test_tables_are_written_where_others_look_for_them(make_run):
    directory = make_run()
    tables = extract(directory.path)
    of_run, of_windows = features.write(tables, directory)
    assert of_run == directory.root / "features" / "run" / "fake_object" / "run003.parquet"
    assert of_windows == directory.root / "features" / "window" / "fake_object" / "run003.parquet"
    for table, path in zip(tables, (of_run, of_windows), strict=True):
        pd.testing.assert_frame_equal(read_table(path), table)
        assert read_table(path).attrs["fields"] == table.attrs["fields"]
    assert read_table(of_windows).attrs["fields"]["window_start_s"] == {"unit": "s"}
    assert len(feature_dataset([read_table(of_run)])) == 1


def test_equal_runs_give_equal_bytes(make_run):
    directory = make_run()
    once = [path.read_bytes() for path in features.write(extract(directory.path), directory)]
    again = [path.read_bytes() for path in features.write(extract(directory.path), directory)]
    assert once == again


def test_a_recording_too_short_for_a_window_has_none(bag_of, messages):
    tables = extract(bag_of([(t / 10, "/scan", messages.scan(t, [1.0, 2.0])) for t in range(3)]))
    assert len(tables.windows) == 0
    assert tables.windows["contextual.range_variance_max"].dtype == np.float64
    assert tables.run["contextual.range_variance_max"].tolist() == [0.25]


def test_an_empty_bag_has_no_features_but_reasons(bag_of):
    table = extract(bag_of([])).run
    assert table[feature_columns(table)].isna().all(axis=None)


def test_a_corrupt_bag_is_an_error_and_not_a_missing_feature(make_run):
    directory = make_run()
    (file,) = directory.bag.glob("*.mcap")
    data = bytearray(file.read_bytes())
    data[len(data) // 4] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(RunDirectoryError, match=rf"{directory.path} is damaged: bag/bag_0\.mcap"):
        extract(directory.path)
