from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.scoring.alarms import (
    MEMORY,
    REPEAT_S,
    Alarm,
    AlarmError,
    AlarmRule,
    AlarmWatch,
    NormalWindows,
    Statistic,
    statistics_of,
)
from oracle_pipeline.scoring.output import paragraph
from oracle_pipeline.scoring.verdict import Verdict
from oracle_pipeline.windows import HOP_S, WINDOW_S

OF_RUN = round(180.0 / HOP_S)  # windows of three minutes
RULE = AlarmRule(allowance=1.0, threshold=3.0, per_hour=1.0)


def recordings(rng, number, windows=OF_RUN, runs_of_block=1):
    """Normal recordings with windows that depend on each other and on their block."""
    block = np.repeat(np.arange(number), runs_of_block)
    run = np.repeat(np.arange(len(block)), windows)
    noise = rng.standard_t(3, size=(len(block), windows + 1))
    level = rng.exponential(size=number)[block]
    scores = level[:, None] + noise[:, 1:] + noise[:, :-1]  # windows overlap by half
    start_s = np.tile(HOP_S * np.arange(windows), len(block))
    return NormalWindows(scores.ravel(), start_s, run, block)


def watched(rule, windows, run):
    watch, of_run = AlarmWatch(rule), windows.run == run
    fed = zip(windows.start_s[of_run] + WINDOW_S, windows.scores[of_run], strict=True)
    return [alarm for alarm in (watch.feed(*each) for each in fed) if alarm]


def alarms_in_sequence(rule, windows, block):
    """Count the alarms of a block with its recordings in sequence."""
    begins_s, raised_s = 0.0, []
    for run in np.flatnonzero(windows.block == block):
        of_run = windows.run == run
        statistic = statistics_of(windows.scores[of_run], windows.run[of_run], rule)
        for end_s in begins_s + windows.start_s[of_run][statistic > rule.threshold] + WINDOW_S:
            if not raised_s or end_s >= raised_s[-1] + REPEAT_S:
                raised_s.append(end_s)
        begins_s += windows.start_s[of_run][-1] + HOP_S
    return len(raised_s)


@given(st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=40))
def test_incremental_statistic_equals_the_batch_statistic(scores):
    statistic = Statistic(RULE)
    fed = [statistic.feed(score) for score in scores]
    run = np.zeros(len(scores), dtype=np.intp)
    np.testing.assert_allclose(statistics_of(np.array(scores), run, RULE), fed, atol=1e-9)


def test_the_statistic_does_not_carry_over_between_recordings():
    scores, run = np.array([9.0, 9.0, 2.0, 2.0]), np.array([0, 0, 1, 1])
    np.testing.assert_allclose(statistics_of(scores, run, RULE), [8.0, 16.0, 1.0, 2.0])


def test_an_extreme_window_raises_an_alarm_at_once_and_small_deviations_raise_it_slowly():
    watch = AlarmWatch(RULE)
    alarm = watch.feed(10.0, 9.0)
    assert (alarm.time_s, alarm.statistic, alarm.threshold) == (10.0, 8.0, 3.0)
    slowly = AlarmWatch(RULE)
    assert [slowly.feed(5.0 * n, 2.0) is not None for n in range(5)].index(True) == 3


def test_the_statistic_is_low_again_a_minute_after_the_last_unusual_window():
    statistic = Statistic(RULE)
    assert statistic.feed(1e6) > 1e5
    assert max([statistic.feed(0.5) for _ in range(MEMORY)][-1:]) < 0.0


def test_after_an_alarm_there_is_none_for_ten_minutes():
    watch = AlarmWatch(RULE)
    ends = np.arange(10.0, 10.0 + 3 * REPEAT_S, HOP_S)
    raised = [end for end in ends if watch.feed(end, 9.0)]
    np.testing.assert_allclose(np.diff(raised), REPEAT_S)


def test_only_a_much_higher_score_or_another_family_breaks_the_silence_of_an_alarm():
    watch, quiet = AlarmWatch(RULE), ((0.5, ()),) * MEMORY
    fed = (
        (9.0, ("map", "scan")), (19.0, ("map",)), *quiet, (9.0, ("scan",)), (20.0, ("map",)),
        (40.0, ("map",)), *quiet, (9.0, ("transforms", "map")), (9.0, ("noise",)), *quiet,
        (9.0, ("transforms",)), (3.5, ("costmap",)), (9.0, ("noise",)),
    )  # fmt: skip
    raised = [
        number
        for number, (score, families) in enumerate(fed)
        if watch.feed(10.0 + HOP_S * number, score, families)
    ]
    assert raised == [0, MEMORY + 4, 2 * MEMORY + 5]


@pytest.mark.parametrize("runs_of_block", [1, 4])
def test_a_new_block_raises_at_most_the_promised_alarms_per_hour(runs_of_block):
    rng, per_hour = np.random.default_rng(0), 1.0
    raised, hours = [], 0.0
    for _ in range(50):
        all_of = recordings(rng, 45, runs_of_block=runs_of_block)
        rule = all_of.without(0).rule(per_hour)
        raised.append(alarms_in_sequence(rule, all_of, 0))
        hours += runs_of_block * OF_RUN * HOP_S / 3600.0
    error = np.std(raised) * np.sqrt(len(raised)) / hours
    assert 0.0 < sum(raised) / hours <= per_hour + 2.0 * error


def test_live_alarms_equal_the_alarms_counted_in_calibration():
    windows = recordings(np.random.default_rng(1), 60)
    rule = windows.rule(2.0)
    raised = sum(len(watched(rule, windows, run)) for run in range(60))
    hours = 60 * OF_RUN * HOP_S / 3600.0
    assert 0 < raised <= 2.0 * hours - 1
    lower = replace(rule, threshold=0.9 * rule.threshold)
    assert sum(len(watched(lower, windows, run)) for run in range(60)) > raised


def test_the_error_for_too_few_hours_states_how_many_are_missing():
    few = recordings(np.random.default_rng(2), 20)
    assert few.lowest_rate() == pytest.approx(1.0)
    few.rule(1.01)
    with pytest.raises(AlarmError, match=r"20 blocks.*1 h.*below 1 false.*0\.5 needs 1 h more"):
        few.rule(0.5)


def test_the_recordings_of_a_block_are_processed_in_sequence():
    assert recordings(np.random.default_rng(3), 20, runs_of_block=3).lowest_rate() == pytest.approx(
        1.0 / 3.0  # nine minutes a block, in which one alarm can be raised
    )


def test_a_block_with_many_recordings_has_no_more_weight_than_others():
    once = recordings(np.random.default_rng(3), 50)
    again = 40 * [0]
    copies = NormalWindows(
        np.r_[once.scores, np.tile(once.scores[:OF_RUN], 40)],
        np.r_[once.start_s, np.tile(once.start_s[:OF_RUN], 40)],
        np.r_[once.run, 50 + np.repeat(np.arange(40), OF_RUN)],
        np.r_[once.block, again],
    )
    assert copies.lowest_rate() == pytest.approx(once.lowest_rate())


def test_an_extreme_window_raises_an_alarm_at_once_even_if_some_normal_recordings_drift():
    rng = np.random.default_rng(4)
    windows = recordings(rng, 60)
    scores = rng.normal(size=windows.scores.shape)
    scores[windows.run < 6] += 5.0  # for three minutes each
    rule = NormalWindows(scores, windows.start_s, windows.run, windows.block).rule(0.5)
    assert AlarmWatch(rule).feed(10.0, 2.0 * scores.max()) is not None


def test_normal_recordings_that_are_too_short_for_some_lengths_calibrate_the_others():
    short = recordings(np.random.default_rng(5), 200, windows=3)
    rule = short.rule(4.0)
    assert np.isinf(rule.reach[3:]).all()
    watch = AlarmWatch(rule)
    assert watch.feed(10.0, 1e3) is not None
    assert np.isfinite(statistics_of(np.ones(9), np.zeros(9, dtype=np.intp), rule)).all()


@pytest.mark.parametrize(
    ("per_hour", "shown"),
    [
        (0.5, "Alarm at 15 s (at most 0.5 false alarms per hour are promised)."),
        (5.1, "Alarm at 15 s, perhaps false: the reference is too short to promise less than "),
    ],
)
def test_alarms_are_marked_if_the_reference_supports_only_a_high_false_alarm_rate(per_hour, shown):
    verdict = Verdict(
        "bag", "normal", p_value=0.3, suite_p_value=0.3, score=0.9,
        alarms=(Alarm(15.0, 4.0, 3.0),), alarms_per_h=per_hour,
    )  # fmt: skip
    assert any(line.strip().startswith(shown) for line in paragraph(verdict))
