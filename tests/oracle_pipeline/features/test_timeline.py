"""A clock that jumps splits a recording into spans; times within a span are unchanged."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline import features
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.features.engine.timeline import epochs, timeline
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.bags.conftest import STRING, text

SECOND = 1_000_000_000
MONTH = 30 * 86_400 * SECOND
MANAGER = features.build_manager()


def clock_of(topics):
    of = epochs(topics)
    stamps = np.concatenate(topics)
    clock = timeline(topics, of, int(stamps.min()), int(stamps.max()))
    return clock, [
        clock.times_ns(stamps, [epoch]) for stamps, epoch in zip(topics, of, strict=True)
    ]


def steady(start_s, seconds, rate):
    return np.arange(start_s * rate, (start_s + seconds) * rate) * (SECOND // rate)


@pytest.mark.parametrize("jump_ns", [MONTH, -MONTH, 3600 * SECOND, -3600 * SECOND, -5 * SECOND])
def test_a_jump_costs_nothing(jump_ns):
    """In file order: two topics for 100 s, the clock set in the middle."""
    base = 10 * MONTH
    whole = [base + steady(0, 100, rate) for rate in (10, 7)]
    jumped = [np.where(t < base + 50 * SECOND, t, t + jump_ns) for t in whole]
    clock, times = clock_of(jumped)
    assert len(clock.starts_ns) == 2
    assert clock.duration_ns == pytest.approx(100 * SECOND, abs=SECOND)
    # A month back, spans are read in order of their stamps unless topics overlap in time.
    between = [np.diff(np.sort(t)) for t in times]
    assert max(b.max() for b in between) <= 0.2 * SECOND
    assert "2 spans" in clock.note()
    told = [(at_s, by_s) for at_s, by_s in clock.set_back]
    if jump_ns < 0:
        assert told == [(pytest.approx(50.0, abs=1.0), pytest.approx(-jump_ns / SECOND, abs=1.0))]
    else:
        assert told == []


def test_first_stamps_of_zero_cost_nothing():
    """A recorder that uses simulated time has stamps of 0 until the clock's first message."""
    clock, (times, _) = clock_of([np.r_[0, MONTH + steady(0, 20, 10)], np.r_[0, 0, MONTH]])
    assert clock.duration_ns < 21 * SECOND
    assert times[:2].tolist() == [0, 1]


@given(st.lists(st.integers(0, 59 * SECOND), min_size=1, max_size=30))
def test_without_a_jump_times_are_those_since_the_start(steps):
    """Whatever the order in which one topic was stored."""
    stamps = MONTH + np.cumsum(steps)
    clock, (times,) = clock_of([np.sort(stamps)])
    assert clock.note() is None
    assert times.tolist() == (stamps - stamps[0]).tolist()
    assert clock.duration_ns == stamps[-1] - stamps[0] + 1


def test_a_sparse_recording_does_not_jump():
    clock, _ = clock_of([np.arange(20) * 3600 * SECOND])
    assert clock.note() is None


def test_one_late_message_is_no_jump():
    topic = steady(10, 50, 10)
    topic[250] = SECOND
    clock, _ = clock_of([topic, steady(10, 50, 10), steady(10, 50, 5)])
    assert clock.note() is None


@pytest.mark.parametrize("jump_ns", [0, MONTH])
def test_windows_exist_only_where_messages_are(jump_ns, tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/chatter", STRING, [])
        for i in range(400):
            bag.write("/chatter", i * SECOND // 10 + jump_ns * (i >= 200), text("x"))
    with open_run(tmp_path / "bag") as run:
        tables = features.extract(run, MANAGER)
    assert tables.windows["window_start_s"].tolist() == [2.5 * n for n in range(15)]
    assert tables.run["generic.message_rate"].iloc[0] == pytest.approx(10.0, rel=0.02)
    assert "generic.jitter_max" not in json.loads(tables.run["missing"].iloc[0])
    assert bool(tables.notes) == bool(jump_ns)
