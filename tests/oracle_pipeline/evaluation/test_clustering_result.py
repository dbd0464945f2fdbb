import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.bootstrap import bootstrap, distinct_runs
from oracle_pipeline.datasets import feature_columns
from oracle_pipeline.evaluation.clustering_result import cluster_and_judge, in_best_cluster
from oracle_pipeline.evaluation.estimate import NOTHING
from tests.oracle_pipeline.datasets.synthetic import run_features


def judged(df, n=300, rate=0.3, seed=0, columns=None, **setting):
    rows = bootstrap(df, n, rate, seed)
    columns = feature_columns(df) if columns is None else columns
    return cluster_and_judge(rows, columns, np.random.default_rng(seed), **setting)


@pytest.fixture(scope="module")
def without_meaning():
    return [judged(run_features(seed=seed), seed=seed) for seed in range(40)]


@pytest.mark.slow
def test_meaningless_labels_give_an_auc_of_chance(without_meaning):
    assert np.mean([result.auc.covers(0.5) for result in without_meaning]) >= 0.9
    assert np.mean([result.auc.value for result in without_meaning]) == pytest.approx(0.5, abs=0.03)


def test_meaningless_labels_still_give_the_recall_that_the_thesis_calls_accuracy(without_meaning):
    recall = np.median([result.recall_best_cluster.value for result in without_meaning])
    false_alarms = np.median([result.fpr_best_cluster.value for result in without_meaning])
    assert recall > 0.85
    assert false_alarms == pytest.approx(recall, abs=0.1)


def test_separate_attacks_are_all_outside_the_largest_cluster():
    result = judged(run_features(effect=40.0))
    assert (result.tp, result.fn, result.fp) == (90, 0, 0)
    assert result.mcc == result.auc.value == result.recall_best_cluster.value == 1.0
    assert result.tpr.low < 0.95  # 45 runs, however many rows
    assert result.fpr_best_cluster.value == 0.0


def test_the_best_cluster_is_described_by_distinct_runs():
    result = judged(run_features(runs=5, effect=40.0))
    assert result.runs_best_cluster == "15/15 malicious, 0/15 others"
    assert result.mcc_best_cluster == 1.0


def test_the_best_cluster_is_one_of_the_inspected_clusters():
    runs = distinct_runs(run_features(runs=1))  # malicious are the second, fourth and sixth
    runs.malicious[:] = [False, True, False, True, False, True]
    clusters = np.array([1, 1, 2, 3, 3, 3], dtype=np.int32)
    assert in_best_cluster(clusters, runs).tolist() == [False] * 3 + [True] * 3
    assert in_best_cluster(clusters, runs, inspected=2).tolist() == [True] * 2 + [False] * 4
    clusters = np.array([1, 3, 2, 3, 2, 3], dtype=np.int32)
    assert not in_best_cluster(clusters, runs, inspected=2).any()


def test_a_result_has_three_columns_for_each_estimate():
    columns = judged(run_features(runs=3)).columns()
    assert {"auc", "auc_low", "auc_high", "fpr", "fpr_low", "fpr_high"} <= columns.keys()
    assert all(isinstance(value, float | int | str) for value in columns.values())


def test_the_result_for_rows_that_cannot_be_clustered_has_the_reason():
    empty = run_features(runs=3).assign(**{"structural.density": np.nan})
    result = judged(empty, columns=["structural.density"])
    assert "rows of 0 features" in result.note
    assert result.auc == NOTHING


def test_a_missing_class_is_noted():
    df = run_features(runs=3)
    result = judged(df[df["label"] == "normal"], rate=0.0)
    assert result.note == "no malicious runs"
    assert (result.auc, result.tpr) == (NOTHING, NOTHING)
    assert result.fpr.value == pytest.approx(result.fp / 300)


def test_indicators_of_missing_values_are_clustered():
    df = run_features(runs=6)
    malicious = df["label"] == "malicious"
    df["structural.density"] = np.where(malicious, np.nan, 0.02)
    rows = pd.DataFrame(df)
    assert judged(rows, columns=["structural.density"]).tpr.value == 1.0
