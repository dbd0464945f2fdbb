import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.evaluation.effort import (
    effort_curve,
    in_small_cluster,
    small_clusters_table,
    smallness,
)
from tests.oracle_pipeline.datasets.synthetic import CONTROLS, MODES, run_features

CLUSTERS = np.array([1, 1, 1, 1, 2, 2, 3, 3], dtype=np.int32)


def test_a_small_cluster_is_smaller_than_the_mean_one():
    assert in_small_cluster(CLUSTERS).tolist() == [False] * 4 + [True] * 4
    assert not in_small_cluster(np.ones(5, dtype=np.int32)).any()
    assert smallness(CLUSTERS).tolist() == [-4.0] * 4 + [-2.0] * 4


def test_runs_of_equal_suspicion_are_inspected_together():
    malicious = np.array([0, 0, 0, 1, 1, 1, 0, 1], dtype=bool)
    curve = effort_curve(smallness(CLUSTERS), malicious)
    assert curve.inspected.tolist() == [0.0, 0.5, 1.0]
    assert curve.found.tolist() == [0.0, 0.75, 1.0]
    assert [curve.at(budget) for budget in (0.4, 0.5, 0.9, 1.0)] == [0.0, 0.75, 0.75, 1.0]


@given(
    st.lists(st.tuples(st.integers(0, 5), st.booleans()), min_size=1).filter(
        lambda runs: any(attacked for _, attacked in runs)
    )
)
def test_an_effort_curve_rises_from_0_to_1(runs):
    suspicion, malicious = (np.array(part) for part in zip(*runs, strict=True))
    curve = effort_curve(suspicion.astype(float), malicious)
    assert (curve.inspected[0], curve.found[0]) == (0.0, 0.0)
    assert (curve.inspected[-1], curve.found[-1]) == (1.0, 1.0)
    assert (np.diff(curve.inspected) > 0).all()
    assert (np.diff(curve.found) >= 0).all()


def test_a_few_anomalous_runs_are_in_small_clusters():
    df = run_features(6, effect=30.0, modes=MODES | CONTROLS)
    rare = df[(df["label"] != "malicious") | (df["block"] == 0)].reset_index(drop=True)
    columns = ["structural.entropy", "contextual.yaw_variance"]
    table = small_clusters_table(rare, columns, np.random.default_rng(0))
    few = table[(table["linkage"] == "average") & (table["kappa"] == 0.1)].iloc[0]
    assert few["found"] == 1.0
    assert few["found_in_budget"] == 1.0
    assert few["failure_share"] == pytest.approx(3 / (few["inspected"] * len(rare)))
    assert table["ari"].between(-1, 1).all()
