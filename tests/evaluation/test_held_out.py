import numpy as np
import pytest

from oracle_pipeline.datasets import distinct_runs, feature_columns, feature_dataset
from oracle_pipeline.evaluation.held_out import held_out_heights
from oracle_pipeline.evaluation.metrics import auc
from tests.datasets.synthetic import run_features


def heights(df):
    return held_out_heights(df, feature_columns(df))


def area(df):
    runs = distinct_runs(df)
    return auc(heights(df)[runs.first], runs, np.random.default_rng(0))


def test_labels_that_mean_nothing_cannot_be_told_from_chance():
    areas = [area(run_features(runs=6, seed=seed)) for seed in range(20)]
    assert np.mean([a.covers(0.5) for a in areas]) >= 0.85
    assert np.mean([a.value for a in areas]) == pytest.approx(0.5, abs=0.05)


def test_a_strong_attack_joins_right_runs_last():
    assert area(run_features(runs=6, effect=20.0)).value > 0.95


def test_a_score_does_not_know_the_runs_own_label_nor_other_attacks():
    df = feature_dataset([run_features(runs=4, effect=1.0)])
    scores = heights(df)
    for row in (0, 9, 17):
        relabelled = df.copy()
        relabelled.loc[row, "label"] = "malicious" if df.at[row, "label"] == "normal" else "normal"
        assert heights(relabelled)[row] == scores[row]
    right = (df["label"] == "normal").to_numpy()
    alone = heights(df[right | (np.arange(len(df)) == 0)])
    assert alone[0] == scores[0]


def test_runs_of_the_only_block_have_no_score():
    assert np.isnan(heights(run_features(runs=1))).all()
