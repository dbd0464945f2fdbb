from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import balanced_accuracy_score, matthews_corrcoef, roc_auc_score

from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.evaluation.estimate import NOTHING, clopper_pearson
from oracle_pipeline.evaluation.metrics import (
    MetricError,
    auc,
    confusion,
    decode_thesis_row,
    events_per_hour,
    false_positive_rate,
    quantile,
    share,
    true_positive_rate,
)


def rng():
    return np.random.default_rng(0)


def runs_of(malicious, copies=None, block=None):
    n = len(malicious)
    return DistinctRuns(
        first=np.arange(n),
        copies=np.ones(n, dtype=np.int64) if copies is None else np.asarray(copies),
        malicious=np.asarray(malicious, dtype=bool),
        block=np.arange(n) if block is None else np.asarray(block),
    )


@st.composite
def samples(draw):
    """Runs of both classes, some copied, with a score that has ties."""
    n = draw(st.integers(2, 25))
    malicious = draw(
        st.lists(st.booleans(), min_size=n, max_size=n).filter(lambda x: 0 < sum(x) < n)
    )
    numbers = st.integers(0, 5)
    copies = draw(st.lists(st.integers(1, 9), min_size=n, max_size=n))
    block = draw(st.lists(numbers, min_size=n, max_size=n))
    score = draw(st.lists(numbers, min_size=n, max_size=n))
    return np.array(score, dtype=float), runs_of(malicious, copies, block)


@settings(max_examples=25)
@given(samples())
def test_the_auc_is_that_of_the_rows_and_within_its_interval(sample):
    score, runs = sample
    area = auc(score, runs, rng())
    assert area.value == pytest.approx(
        roc_auc_score(runs.malicious, score, sample_weight=runs.copies)
    )
    assert 0.0 <= area.low <= area.value <= area.high <= 1.0


@settings(max_examples=25)
@given(samples(), st.integers(2, 50))
def test_copying_every_run_does_not_narrow_the_interval(sample, times):
    score, runs = sample
    copied = replace(runs, copies=runs.copies * times)
    once, often = auc(score, runs, rng()), auc(score, copied, rng())
    assert (once.low, once.high) == pytest.approx((often.low, often.high))
    flagged = score > 2
    assert true_positive_rate(flagged, runs) == true_positive_rate(flagged, copied)


@settings(max_examples=25)
@given(samples())
def test_verdicts_are_counted_by_rows(sample):
    score, runs = sample
    flagged = score > 2
    counts = confusion(flagged, runs)
    weights = {"sample_weight": runs.copies}
    assert counts.tp + counts.fn == runs.copies[runs.malicious].sum()
    assert counts.fp + counts.tn == runs.copies[~runs.malicious].sum()
    assert counts.mcc == pytest.approx(matthews_corrcoef(runs.malicious, flagged, **weights))
    balanced = balanced_accuracy_score(runs.malicious, flagged, **weights)
    assert auc(flagged.astype(float), runs, rng()).value == pytest.approx(balanced)
    tpr, fpr = true_positive_rate(flagged, runs), false_positive_rate(flagged, runs)
    assert (tpr.value + 1 - fpr.value) / 2 == pytest.approx(balanced)


def test_a_missing_class_gives_an_empty_estimate():
    runs = runs_of([True, True])
    assert auc(np.array([1.0, 2.0]), runs, rng()) == NOTHING
    assert false_positive_rate(np.array([True, False]), runs) == NOTHING
    assert np.isnan(confusion(np.array([True, False]), runs).mcc)


def test_runs_without_a_score_are_left_out():
    score = np.array([3.0, np.nan, 1.0, 2.0])
    whole = auc(score, runs_of([True, True, False, False]), rng())
    assert whole.value == auc(score[[0, 2, 3]], runs_of([True, False, False]), rng()).value == 1.0


def test_the_interval_counts_runs_of_one_block_as_one():
    generator = np.random.default_rng(3)
    malicious = np.tile([True, False], 30)
    score = generator.normal(size=60) + np.repeat(generator.normal(size=6), 10) * ~malicious
    loose = auc(score, runs_of(malicious), rng())
    blocked = auc(score, runs_of(malicious, block=np.repeat(np.arange(6), 10)), rng())
    assert blocked.high - blocked.low > 1.3 * (loose.high - loose.low)


def test_figures_that_no_hard_verdict_gives_are_an_error():
    with pytest.raises(MetricError, match=r"recall of 0\.9 and an AUC of 0\.3"):
        decode_thesis_row(tpr=0.9, auc=0.3)


def test_an_auc_within_groups_compares_no_runs_of_different_groups():
    """A score that only names the group separates nothing within it."""
    malicious = np.tile([True, True, True, False, False, False, False, True], 10)
    mode = np.tile(np.repeat(["attack", "normal"], 4), 10)
    block = np.repeat(np.arange(10), 8)
    runs = runs_of(malicious, block=block)
    names_the_mode = np.where(mode == "attack", 1.0, 0.0)
    assert auc(names_the_mode, runs, rng()).value == 0.75
    assert auc(names_the_mode, runs, rng(), within=mode).value == 0.5
    score = np.random.default_rng(0).normal(size=80) + malicious
    by_hand = [
        float(np.mean(score[of & malicious][:, None] > score[of & ~malicious]))
        for of in (mode == "attack", mode == "normal")
    ]
    area = auc(score, runs, rng(), within=mode)
    assert area.value == pytest.approx(np.mean(by_hand))  # as many pairs in either mode
    assert area.low < area.value < area.high
    assert auc(score, runs, rng(), within=malicious) == NOTHING


@settings(max_examples=25)
@given(samples())
def test_the_auc_depends_only_on_the_order_of_scores(sample):
    score, runs = sample
    assert auc(score, runs, rng()) == auc(np.exp(3.0 * score) - 7.0, runs, rng())
    mirrored = auc(-score, runs, rng())
    assert mirrored.value == pytest.approx(1.0 - auc(score, runs, rng()).value)


def test_the_interval_of_a_share_respects_blocks_and_contains_the_exact_interval():
    hit = np.repeat([True, False, False, False], 10)
    exact = clopper_pearson(0.25, 40)
    loose, blocked = (
        share(hit, block, rng()) for block in (np.arange(40), np.repeat(np.arange(4), 10))
    )
    assert loose.value == blocked.value == 0.25
    assert loose.low <= exact.low
    assert loose.high >= exact.high
    assert blocked.high - blocked.low > 1.5 * (loose.high - loose.low)
    assert share(hit, np.arange(40), rng(), 0.9).low > loose.low
    assert share(hit[:0], np.arange(0), rng()) == NOTHING


def test_a_quantile_may_be_infinite():
    values, block = np.array([1.0, 2.0, 3.0, np.inf, np.inf]), np.arange(5)
    assert quantile(values, block, 0.5, rng()).value == 3.0
    assert quantile(values, block, 0.9, rng()).value == np.inf
    assert quantile(values, block, 0.5, rng()).high == np.inf
    assert quantile(values[:0], block[:0], 0.5, rng()) == NOTHING


def test_events_are_counted_per_hour_and_zero_events_have_an_upper_bound():
    seconds, block = np.full(10, 360.0), np.arange(10)
    none = events_per_hour(np.zeros(10, dtype=int), seconds, block, rng())
    assert (none.value, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(-np.log(0.025))  # exact for a count of 0
    assert events_per_hour(np.full(10, 3), seconds, block, rng()).value == pytest.approx(30.0)
    assert events_per_hour(np.zeros(0, dtype=int), seconds[:0], block[:0], rng()) == NOTHING


def test_a_higher_level_gives_a_wider_interval():
    generator = np.random.default_rng(0)
    runs, score = runs_of(np.tile([True, False], 20)), generator.normal(size=40)
    usual, sure = auc(score, runs, rng()), auc(score, runs, rng(), 0.999)
    assert sure.low < usual.low < usual.high < sure.high
