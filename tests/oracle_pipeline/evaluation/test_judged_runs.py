import numpy as np
import pytest

from oracle_pipeline.bags.manifest import Change
from oracle_pipeline.datasets import DatasetError
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.truth import COLUMNS, truth_table
from oracle_pipeline.scoring.feature_sets import feature_sets
from tests.oracle_pipeline.datasets.synthetic import campaign
from tests.oracle_pipeline.evaluation.campaigns import by_hand
from tests.oracle_pipeline.reporting.recordings import manifest


def test_windows_have_their_run_and_place():
    judged = by_hand(("lidar_passthrough", 1, 18.0, 0.0, "[]"), ("fake_object", 0, 21.0, 0.0, "[]"))
    assert judged.features["mode"].tolist() == ["fake_object", "lidar_passthrough"]
    assert judged.run.tolist() == 8 * [0] + 7 * [1]
    assert judged.counts.tolist() == [8, 7]
    assert judged.place.tolist() == [*range(8), *range(7)]


def test_an_attack_that_never_began_is_left_out_and_a_run_without_truth_is_an_error():
    judged = by_hand(
        ("delayed_fakeobject", 0, 20.0, np.nan, "[]"), ("lidar_passthrough", 0, 20.0, 0.0, "[]")
    )
    assert judged.features["mode"].tolist() == ["lidar_passthrough"]
    features, windows, truth = campaign(3)
    with pytest.raises(DatasetError, match=r"1 runs, fake_object\|run001 .* truth table"):
        JudgedRuns.of(features, windows, truth[truth["run_id"] != "fake_object|run001"])


def test_shortcuts_and_thesis_features_are_in_separate_sets():
    features, _, _ = campaign(3)
    features = features.assign(
        **{
            "thesis.vector_0": 1.0, "redundancy.residual": 1.0, "pairs.rate_ratio": 1.0,
            "generic.identity": 1.0,
        }
    )  # fmt: skip
    features.attrs["fields"] = {
        **features.attrs["fields"],
        "redundancy.residual": {"origin": "domain", "shortcut": "false"},
        "pairs.rate_ratio": {"origin": "domain", "shortcut": "false"},
        "generic.identity": {"origin": "generic", "shortcut": "true"},
    }
    sets = feature_sets(features)
    own = {c for c in features if c.startswith(("structural.", "contextual."))}
    assert set(sets["all"]) == own | {"redundancy.residual", "pairs.rate_ratio"}
    assert sets["misbehaviour"] == ["contextual.yaw_variance", "contextual.duration"]
    assert sorted(sets["tampering"] + sets["misbehaviour"]) == sorted(sets["all"])


def test_the_truth_table_has_the_values_of_the_manifests():
    record = manifest(changes=(Change(5.0, 2, 0.25), Change(10.0, 1, None)))
    table = truth_table([record])
    assert tuple(table.columns) == COLUMNS
    row = table.iloc[0]
    assert row["run_id"] == f"{record.mode}|run{record.run:03d}"
    assert row["changes"] == "[[5.0, 2, 0.25], [10.0, 1, null]]"
    assert row["recording_s"] == record.recording_s
