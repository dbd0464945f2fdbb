"""What is unusual in a run, compared with the normal runs of other blocks."""

import numpy as np
import pytest

from oracle_pipeline.datasets import feature_columns
from oracle_pipeline.evaluation.run_deviations import deviations_of_runs
from tests.oracle_pipeline.datasets.synthetic import ATTACKED, campaign

RUNS = 6


@pytest.fixture(scope="module")
def df():
    return campaign(RUNS, effect=30.0)[0]


def test_the_usual_range_is_that_of_normal_runs_of_other_blocks(df):
    found = {each.feature: each for each in deviations_of_runs(df)["random_noise|run002"]}
    right = df[(df["label"] != "malicious") & (df["block"] != 2)]
    assert set(ATTACKED) <= set(found) <= set(feature_columns(df))
    for name, each in found.items():
        low, high = np.percentile(right[name], [5, 95])
        assert (each.usual_low, each.usual_high) == pytest.approx((low, high))
        assert not low <= each.value <= high


def test_the_features_that_an_attack_changed_are_the_farthest(df):
    found = deviations_of_runs(df)
    for run in df.loc[df["label"] == "malicious", "run_id"]:
        assert {each.feature for each in found[run][:2]} == set(ATTACKED)


def test_without_a_normal_run_of_another_block_nothing_is_said(df):
    assert deviations_of_runs(df[df["block"] == 0]) == {}
