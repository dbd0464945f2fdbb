import numpy as np
import pytest

from oracle_pipeline.detectors import panel
from oracle_pipeline.evaluation.held_out import conformal, held_out, of_tested, standardised
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.evaluation.splits import Fold, block_folds
from tests.oracle_pipeline.datasets.synthetic import ATTACKED, campaign
from tests.oracle_pipeline.evaluation.campaigns import synthetic

COLUMNS = [*ATTACKED, "structural.density", "contextual.duration"]
DETECTOR = panel(0)["mahalanobis"]


def mask(*rows, n):
    return np.isin(np.arange(n), rows)


def scored(judged, seed=0):
    return held_out(judged, COLUMNS, DETECTOR, block_folds(judged.features, seed))


def test_labels_of_tested_runs_do_not_reach_their_scores():
    features, windows, truth = campaign(5, effect=2.0)
    judged = JudgedRuns.of(features, windows, truth)
    scores, folds = scored(judged), block_folds(judged.features, 0)
    relabelled = judged.features["label"].where(~folds[0].test, "malicious")
    blind = JudgedRuns.of(judged.features.assign(label=relabelled), windows, truth)
    again = scored(blind)
    assert np.array_equal(again.score[folds[0].test], scores.score[folds[0].test])
    assert np.array_equal(again.p[folds[0].test], scores.p[folds[0].test])


def test_values_of_tested_runs_do_not_reach_other_scores():
    features, windows, truth = campaign(5)
    judged = JudgedRuns.of(features, windows, truth)
    test = block_folds(judged.features, 0)[0].test
    odd = judged.features.copy()
    odd.loc[np.flatnonzero(test)[0], COLUMNS] = 1e6
    before, after = scored(judged), scored(JudgedRuns.of(odd, windows, truth))
    assert np.array_equal(before.score[test][1:], after.score[test][1:])


def test_a_planted_attack_is_detected():
    planted = synthetic(9, effect=15.0)
    assert (scored(planted).p[planted.malicious] <= 0.05).mean() > 0.95


def test_without_attacks_the_false_positive_rate_is_at_most_nominal():
    campaigns = [(synthetic(15, seed=seed), seed) for seed in range(6)]
    rates = [(scored(nothing, seed).p <= 0.05).mean() for nothing, seed in campaigns]
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


def test_no_finite_value_and_no_folds_give_no_score():
    judged = synthetic(3)
    empty = judged.features.assign(**dict.fromkeys(COLUMNS, np.nan))
    alone = JudgedRuns.of(empty, judged.windows, judged.truth)
    folds = block_folds(empty, 0)
    assert np.isnan(held_out(alone, COLUMNS, DETECTOR, folds).score).all()
    assert np.isnan(held_out(judged, COLUMNS, DETECTOR, []).p).all()
