import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.clustering.scaling import CLIP, FlooredRobustScaler
from oracle_pipeline.datasets import feature_columns, feature_floors
from oracle_pipeline.detectors import UsualRanges, by_family
from tests.oracle_pipeline.datasets.synthetic import run_features

DF = run_features(runs=15)
COLUMNS = feature_columns(DF)


def deviations(row, normal=DF):
    return UsualRanges(normal, COLUMNS).deviations(row)


def test_the_feature_that_was_moved_comes_first_with_its_value_and_unit():
    row = DF.iloc[[3]].copy()
    row["contextual.duration"] = 9000.0
    first, *others = deviations(row)
    scaler = FlooredRobustScaler(feature_floors(DF)).fit(DF[COLUMNS])
    at = scaler.kept_.index("contextual.duration")
    assert (first.feature, first.value, first.unit) == ("contextual.duration", 9000.0, "s")
    assert first.median == scaler.center_[at] == pytest.approx(DF["contextual.duration"].median())
    assert first.z == pytest.approx(min(CLIP, (9000.0 - first.median) / scaler.scale_[at]))
    assert [abs(each.z) for each in others] == sorted((abs(e.z) for e in others), reverse=True)


@given(st.integers(0, len(DF) - 1), st.lists(st.floats(-1e3, 1e3), min_size=5, max_size=5))
def test_no_feature_within_its_usual_range_is_listed(number, moved):
    row = DF.iloc[[number]].copy()
    row[COLUMNS] = row[COLUMNS].to_numpy() + np.array(moved)
    named = deviations(row)
    for each in named:
        low, high = np.percentile(DF[each.feature], [5, 95])
        assert (each.usual_low, each.usual_high) == pytest.approx((low, high))
        assert not low <= each.value <= high
        assert np.sign(each.z) == np.sign(each.value - each.median)
    far = [c for c, by in zip(COLUMNS, moved, strict=True) if abs(by) > 500.0]
    assert set(far) - {"contextual.duration"} <= {each.feature for each in named}


def test_a_capped_z_is_marked_and_order_is_by_the_uncapped_z():
    row = DF.iloc[[3]].copy()
    row["contextual.range_variance"], row["structural.entropy"] = 1e3, 1e6
    first, second, *others = deviations(row)
    assert [first.feature, second.feature] == ["structural.entropy", "contextual.range_variance"]
    assert (first.z, first.capped) == (second.z, second.capped) == (CLIP, True)
    assert not any(each.capped for each in others)


def test_a_run_like_the_median_has_no_deviations():
    row = DF.iloc[[0]].copy()
    row[COLUMNS] = DF[COLUMNS].median().to_numpy()
    assert deviations(row) == []


def test_missing_features_are_not_deviations():
    row = DF.iloc[[3]].assign(**{"contextual.duration": np.nan})
    assert "contextual.duration" not in [each.feature for each in deviations(row)]


def test_what_few_normal_runs_have_has_no_usual_range():
    rare = DF.assign(**{"contextual.duration": DF["contextual.duration"].where(DF.index < 3)})
    row = DF.iloc[[3]].assign(**{"contextual.duration": 9000.0})
    assert "contextual.duration" not in {each.feature for each in deviations(row, rare)}


def test_families_are_summarised_by_their_farthest_feature():
    row = DF.iloc[[3]].copy()
    row[COLUMNS] = DF[COLUMNS].median().to_numpy()
    row["contextual.range_variance"], row["contextual.yaw_variance"] = 3.0, 100.0
    row["structural.entropy"] = 5.0
    first, second = by_family(deviations(row), COLUMNS)
    assert (first.family, first.unusual, first.compared) == ("contextual", 2, 3)
    assert (first.feature, first.capped) == ("contextual.yaw_variance", True)
    assert (second.family, second.unusual, second.compared) == ("structural", 1, 2)
