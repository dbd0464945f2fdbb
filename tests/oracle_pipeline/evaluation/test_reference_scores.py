"""The evaluation's headline scores are those of `oracle score`."""

import numpy as np
import pytest

from oracle_pipeline.evaluation.reference_scores import reference_scores
from oracle_pipeline.evaluation.splits import group_folds
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.feature_sets import ASPECTS
from oracle_pipeline.scoring.judging import judge
from oracle_pipeline.scoring.learning import Cards
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.reference import Reference
from tests.oracle_pipeline.datasets.synthetic import campaign


@pytest.fixture(scope="module")
def tables():
    features, windows, _ = campaign(runs=8, effect=2.0)
    return features, windows


@pytest.mark.slow
def test_oracle_score_gives_the_p_values_of_the_evaluation(tables):
    features, windows = tables
    runs = MeasuredRuns.ordered(features, windows)
    measured = reference_scores(runs)
    of_aspects = {name: reference_scores(runs, features=name) for name in ASPECTS}
    cards = Cards(Reference(features, windows))
    for row in range(0, len(features), 3):
        run = runs.features.iloc[[row]]
        of_run = runs.windows[runs.windows["run_id"] == run["run_id"].iloc[0]]
        verdict = judge("run", FeatureTables(run, of_run), cards.card_for(run), 0.5)
        assert verdict.p_value == pytest.approx(measured.p[row])
        assert verdict.score == pytest.approx(measured.score[row])
        for name, scores in of_aspects.items():
            assert verdict.aspects[name].p_value == pytest.approx(scores.p[row])
            assert verdict.aspects[name].score == pytest.approx(scores.score[row])


def test_a_held_out_session_is_judged_by_a_scorer_of_the_other_sessions(tables):
    features, windows = tables
    runs = MeasuredRuns.ordered(features, windows)
    folds = group_folds(runs.features, "session", seed=0)
    scores = reference_scores(runs, folds)
    assert np.isfinite(scores.p).all()
    sessions = [set(runs.features.loc[fold.test, "session"]) for fold in folds]
    blocks = [runs.features.loc[~fold.test, "block"].nunique() for fold in folds]
    assert [len(session) for session in sessions] == [1, 1, 1]
    assert scores.calibration == min(blocks)


def test_two_blocks_are_too_few_for_a_score(tables):
    features, windows = tables
    runs = MeasuredRuns.ordered(features[features["block"] < 2], windows)
    scores = reference_scores(runs)
    assert np.isnan(scores.score).all()
    assert scores.calibration == 0
