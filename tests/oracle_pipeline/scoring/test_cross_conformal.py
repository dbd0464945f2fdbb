from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.datasets import feature_columns, feature_floors
from oracle_pipeline.detectors import panel
from oracle_pipeline.scoring.conformal import ConformalError
from oracle_pipeline.scoring.cross_conformal import CrossConformalScorer, assign_folds
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.scoring.run_scorer import Design
from tests.oracle_pipeline.datasets.synthetic import campaign

NORMAL = {"lidar_passthrough": "normal"}
ATTACKED = {"fake_object": "malicious"}


def runs(number, seed, modes=NORMAL, effect=0.0):
    features, windows, _ = campaign(number, effect, seed, modes)
    return MeasuredRuns.ordered(features, windows)


def design(of, detector="mahalanobis"):
    return Design(
        panel(0)[detector],
        feature_columns(of.features),
        feature_columns(of.windows),
        feature_floors(of.features),
    )


def learned(of, seed=0, detector="mahalanobis"):
    return CrossConformalScorer(design(of, detector)).fit(of, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def normal():
    return runs(20, seed=0)


@pytest.fixture(scope="module")
def scorer(normal):
    return learned(normal)


def test_twenty_recordings_support_a_false_positive_rate_of_five_percent(scorer):
    attacked = runs(5, seed=1, modes=ATTACKED, effect=60.0)
    np.testing.assert_allclose(scorer.p_values(scorer.scores(attacked)), 1 / 21)


@pytest.mark.slow
def test_new_normal_runs_are_called_anomalous_as_rarely_as_promised():
    p = []
    for seed in range(40):
        of = runs(30, seed)
        known = np.arange(len(of.features)) < 20
        scorer = learned(of.where(known), seed)
        p.append(scorer.p_values(scorer.scores(of.where(~known))))
    p = np.concatenate(p)
    for rate in (0.05, 0.1, 0.2, 0.5):
        # 400 p-values in 40 groups: two standard errors, if all of a group moved together.
        assert np.mean(p <= rate) <= rate + 2.0 * np.sqrt(rate * (1.0 - rate) / 40.0)
        assert np.mean(p <= rate) >= 0.4 * rate


def test_every_run_calibrates_a_model_that_was_not_fitted_on_its_block(normal):
    doubled = normal.concat(normal)
    fold = assign_folds(doubled.block, 7, np.random.default_rng(0))
    assert fold.max() == 6
    for block in np.unique(doubled.block):
        assert len(set(fold[doubled.block == block])) == 1


@settings(max_examples=10, deadline=None)
@given(st.integers(9, 20), st.integers(1, 25))
def test_with_three_sessions_no_session_is_split(blocks, sessions):
    of = runs(blocks, 0, {**NORMAL, "lidar_passthrough_odom": "normal"})
    session = of.block % sessions
    of = replace(of, features=of.features.assign(session=session))
    scorer = learned(of, detector="z_3")
    unit = session if sessions >= 3 else of.block
    for name in np.unique(unit):
        assert len(set(scorer.fold_[unit == name])) == 1
    assert len(scorer.scorers_) == min(10, len(np.unique(unit)))


def test_blocks_of_two_joined_campaigns_are_not_split():
    of = runs(9, 0, {**NORMAL, "lidar_passthrough_odom": "normal"})
    session = of.block % 3 + 3 * (of.features["mode"] == "lidar_passthrough")  # of two days each
    scorer = learned(replace(of, features=of.features.assign(session=session)), detector="z_3")
    assert all(len(set(scorer.fold_[of.block == block])) == 1 for block in range(9))


def test_a_run_of_a_known_block_is_judged_by_the_model_that_left_the_block_out(normal, scorer):
    p = scorer.p_values(scorer.scores(normal), normal.block)
    ranks = [(1 + np.sum(np.delete(scorer.held_out_, i) >= scorer.held_out_[i])) / 20
             for i in range(20)]  # fmt: skip
    np.testing.assert_allclose(p, ranks)


def test_a_block_has_the_same_weight_for_any_number_of_runs(normal, scorer):
    p = scorer.p_values(scorer.scores(normal))
    copied = np.r_[np.arange(20), np.full(5, 3)]
    scorer_of_copies = learned(normal)
    for name in ("block_", "fold_", "held_out_"):
        setattr(scorer_of_copies, name, getattr(scorer, name)[copied])
    np.testing.assert_allclose(scorer_of_copies.p_values(scorer.scores(normal)), p)


def test_the_order_of_the_recordings_does_not_matter(normal, scorer):
    backwards = normal.features.iloc[::-1], normal.windows.iloc[::-1]
    other = learned(MeasuredRuns.ordered(*backwards))
    attacked = runs(5, seed=1, modes=ATTACKED, effect=3.0)
    np.testing.assert_array_equal(other.scores(attacked), scorer.scores(attacked))


def test_runs_can_be_scored_without_features_of_windows(normal):
    of = Design(panel(0)["z_3"], feature_columns(normal.features), [], {})
    scorer = CrossConformalScorer(of).fit(normal, np.random.default_rng(0))
    assert scorer.scores(normal).shape == (3, 20)  # the runs are of three sessions


def test_a_window_has_the_same_score_alone_and_among_others(normal, scorer):
    attacked = runs(2, seed=1, modes=ATTACKED, effect=3.0).windows
    together = scorer.window_scores(attacked)
    alone = [scorer.window_scores(attacked.iloc[[row]])[0] for row in range(len(attacked))]
    np.testing.assert_allclose(alone, together)
    held_out = scorer.window_scores(normal.windows, normal.block[normal.run])
    np.testing.assert_array_equal(held_out, scorer.windows_.scores)


def test_too_few_blocks_are_an_error_with_the_number(normal):
    with pytest.raises(ConformalError, match="count as 2 blocks"):
        learned(normal.where(normal.block < 2))
