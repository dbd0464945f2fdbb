import numpy as np
import pytest

from oracle_pipeline.detectors import panel
from oracle_pipeline.evaluation.held_out import (
    common_length,
    conformal,
    held_out,
    of_tested,
    standardised,
    supervised_scores,
    top_windows,
)
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.splits import Fold, block_folds
from tests.oracle_pipeline.datasets.synthetic import ATTACKED, campaign
from tests.oracle_pipeline.evaluation.campaigns import by_hand, synthetic

COLUMNS = [*ATTACKED, "structural.density", "contextual.duration"]
DETECTOR = panel(0)["mahalanobis"]


def mask(*rows, n):
    return np.isin(np.arange(n), rows)


def scored(judged, level="both", seed=0):
    return held_out(judged, COLUMNS, DETECTOR, block_folds(judged.features, seed), level)


@pytest.mark.parametrize("level", ["run", "windows", "both"])
def test_labels_of_tested_runs_do_not_reach_their_scores(level):
    features, windows, truth = campaign(5, effect=2.0)
    judged = JudgedRuns.of(features, windows, truth)
    scores, folds = scored(judged, level), block_folds(judged.features, 0)
    relabelled = judged.features["label"].where(~folds[0].test, "malicious")
    blind = JudgedRuns.of(judged.features.assign(label=relabelled), windows, truth)
    again = scored(blind, level)
    assert np.array_equal(again.score[folds[0].test], scores.score[folds[0].test])
    assert np.array_equal(again.p[folds[0].test], scores.p[folds[0].test])


def test_values_of_tested_runs_do_not_reach_other_scores():
    features, windows, truth = campaign(5)
    judged = JudgedRuns.of(features, windows, truth)
    test = block_folds(judged.features, 0)[0].test
    odd = judged.features.copy()
    odd.loc[np.flatnonzero(test)[0], COLUMNS] = 1e6
    before, after = scored(judged, "run"), scored(JudgedRuns.of(odd, windows, truth), "run")
    assert np.array_equal(before.score[test][1:], after.score[test][1:])


def test_a_planted_attack_is_detected():
    planted = synthetic(9, effect=15.0)
    assert (scored(planted).p[planted.malicious] <= 0.05).mean() > 0.95


def test_without_attacks_the_false_positive_rate_is_at_most_nominal():
    campaigns = [(synthetic(15, seed=seed), seed) for seed in range(6)]
    rates = [(scored(nothing, "run", seed).p <= 0.05).mean() for nothing, seed in campaigns]
    assert 0.01 < np.mean(rates) < 0.06  # 2 of 49 ranks


def test_folds_are_brought_to_one_scale_without_changing_their_order():
    fold = Fold(*(mask(*rows, n=6) for rows in [(0,), (1, 2, 3), (4, 5), (0, 1, 2, 3)]))
    scores = np.array([[np.nan, 10.0, 20.0, 30.0, 20.0, 50.0]])
    scaled = standardised(scores, [fold])
    assert scaled[0, 4:].tolist() == pytest.approx([0.0, 30.0 / 14.826])
    assert standardised(np.array([[0.0, 7.0, 7.0, 7.0, 7.0, 9.0]]), [fold])[0, 5] == 2.0
    assert of_tested(scores, [fold]).tolist()[4:] == [20.0, 50.0]
    assert np.isnan(of_tested(scores, [fold])[:4]).all()
    assert conformal(scores, [fold])[4:].tolist() == [0.75, 0.25]


def test_a_run_is_scored_by_its_most_unusual_windows_up_to_the_common_length():
    judged = by_hand(
        ("delayed_passthrough", 0, 30.0, 0.0, "[]"), ("fake_object", 1, 60.0, 0.0, "[]")
    )
    assert judged.counts.tolist() == [11, 23]
    fold = Fold(*(mask(*rows, n=2) for rows in [(0,), (), (1,), (0,)]))
    scores = np.full((1, 34), np.nan)
    scores[0, 11:] = [*np.arange(1.0, 12.0), *[100.0] * 12]
    top = top_windows(scores, judged, [fold])
    assert top[0, 1] == np.mean([6.0, 7.0, 8.0, 9.0, 10.0, 11.0])
    assert np.isnan(top[0, 0])
    assert common_length(np.array([3, *[20] * 10])) == 20
    assert common_length(np.arange(11, 32)) == 13


def test_no_finite_value_and_no_folds_give_no_score():
    judged = synthetic(3)
    empty = judged.features.assign(**dict.fromkeys(COLUMNS, np.nan))
    alone = JudgedRuns.of(empty, judged.windows, judged.truth)
    folds = block_folds(empty, 0)
    assert np.isnan(held_out(alone, COLUMNS, DETECTOR, folds).score).all()
    assert np.isnan(held_out(judged, COLUMNS, DETECTOR, []).p).all()


def test_a_supervised_classifier_detects_known_attacks_and_is_at_chance_without_an_effect():
    from sklearn.linear_model import LogisticRegression

    judged = synthetic(9, effect=8.0)
    folds = block_folds(judged.features, 0)
    probability = supervised_scores(judged.features, COLUMNS, LogisticRegression(), folds)
    assert probability[judged.malicious].min() > np.median(probability[~judged.malicious])
    one_kind = np.zeros(len(judged.features), dtype=bool)
    silent = supervised_scores(judged.features, COLUMNS, LogisticRegression(), folds, one_kind)
    assert np.isnan(silent).all()
