import numpy as np
import pytest

from oracle_pipeline.datasets import feature_columns, feature_floors
from oracle_pipeline.detectors import explain, panel, pipeline
from tests.oracle_pipeline.datasets.synthetic import run_features


@pytest.fixture(scope="module")
def df():
    return run_features(runs=15)


@pytest.fixture(scope="module")
def oracle(df):
    return pipeline(panel(0)["mahalanobis"], feature_floors(df)).fit(df[feature_columns(df)])


def test_the_feature_that_was_moved_comes_first_with_its_value_and_unit(df, oracle):
    row = df.iloc[[3]].copy()
    row["contextual.duration"] = 9000.0
    first, *others = explain(oracle, row)
    scaler = oracle[0]
    at = scaler.kept_.index("contextual.duration")
    assert (first.feature, first.value, first.unit) == ("contextual.duration", 9000.0, "s")
    assert first.median == scaler.center_[at] == pytest.approx(df["contextual.duration"].median())
    assert first.z == pytest.approx(min(50.0, (9000.0 - first.median) / scaler.scale_[at]))
    assert [abs(each.z) for each in others] == sorted((abs(e.z) for e in others), reverse=True)
    assert {first.feature, *(each.feature for each in others)} == set(feature_columns(df))


def test_what_is_missing_explains_nothing(df, oracle):
    row = df.iloc[[3]].assign(**{"contextual.duration": np.nan})
    assert "contextual.duration" not in [each.feature for each in explain(oracle, row)]
