"""The robot's time between the ticks of its clock."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from oracle_pipeline.bags.types import message_class, serialize
from oracle_pipeline.live.intake import Received
from oracle_pipeline.live.time_base import CLOCK_TOPIC, RobotTime, Step, _SimulatedTime

SECOND_NS = 10**9
TEN_NS = SECOND_NS // 10
CLOCK = "rosgraph_msgs/msg/Clock"


def tick(now_ns):
    time = message_class("builtin_interfaces/msg/Time")(*divmod(now_ns, SECOND_NS))
    return serialize(message_class(CLOCK)(time), CLOCK)


def at(wall_ns, said=b"", *, later_ns=0, writer=1):
    """Return a message that was sent at a time and came later."""
    came_ns = wall_ns + later_ns
    return Received(CLOCK_TOPIC, wall_ns, came_ns, came_ns, writer, said)


@given(st.floats(0.1, 20.0), st.integers(0, 10**12), st.floats(0.0, 0.1))
def test_time_goes_on_as_fast_as_the_clock_does(speed, begin_ns, later_s):
    time, wall_ns = _SimulatedTime(), 5 * SECOND_NS
    period_ns = SECOND_NS // 10
    for number in range(10):
        time.tick(
            at(wall_ns + number * period_ns, tick(begin_ns + round(number * period_ns * speed)))
        )
    last_ns = wall_ns + 9 * period_ns
    expected = begin_ns + speed * (9 * period_ns + later_s * SECOND_NS)
    assert time.stamp_ns(at(last_ns + round(later_s * SECOND_NS))) == pytest.approx(
        expected, abs=100
    )


ticks = st.tuples(st.integers(1, SECOND_NS), st.integers(0, 100 * SECOND_NS))


@given(st.lists(ticks, min_size=3, max_size=30))
def test_stamps_never_run_back_whatever_the_clock_says(said):
    time, wall_ns, stamps = _SimulatedTime(), 0, []
    for later_ns, now_ns in said:
        wall_ns += later_ns
        time.tick(at(wall_ns, tick(now_ns)))
        if time.is_ready:
            stamps.append(time.stamp_ns(at(wall_ns)))
    assert stamps == sorted(stamps)


def test_time_stops_with_the_clock():
    time = _SimulatedTime()
    time.tick(at(0, tick(0)))
    time.tick(at(SECOND_NS, tick(SECOND_NS)))
    assert time.stamp_ns(at(100 * SECOND_NS)) <= 2 * SECOND_NS
    assert time.stamp_ns(at(200 * SECOND_NS)) == time.stamp_ns(at(300 * SECOND_NS))


def test_one_tick_does_not_determine_the_speed():
    time = _SimulatedTime()
    assert not time.is_ready
    time.tick(at(0, tick(0)))
    assert not time.is_ready
    time.tick(at(1, tick(5)))
    assert time.is_ready


@given(st.integers(0, SECOND_NS))
def test_a_message_has_the_time_at_which_it_was_sent_even_if_it_is_late(later_ns):
    time = _SimulatedTime()
    for number in range(10):
        time.tick(at(number * TEN_NS, tick(number * SECOND_NS), later_ns=later_ns))
    sent_ns = 4 * TEN_NS + TEN_NS // 4
    assert time.stamp_ns(at(sent_ns, later_ns=later_ns)) == 4 * SECOND_NS + SECOND_NS // 4


def test_where_clocks_of_machines_disagree_it_counts_when_a_message_comes():
    time, hour_ns = _SimulatedTime(), 3600 * SECOND_NS
    for number in range(3):
        came_ns = hour_ns + number * SECOND_NS
        time.tick(
            Received(CLOCK_TOPIC, came_ns + hour_ns, came_ns, came_ns, 1, tick(number * TEN_NS))
        )
    came_ns = hour_ns + SECOND_NS
    assert time.stamp_ns(Received("/scan", 0, came_ns, came_ns, 2, b"")) == TEN_NS


def test_of_two_clocks_the_first_counts_while_it_ticks():
    time = _SimulatedTime()
    for number in range(5):
        time.tick(at(number * TEN_NS, tick(number * TEN_NS)))
        time.tick(at(number * TEN_NS + 1, tick(hour := 3600 * SECOND_NS), writer=2))
    assert time.stamp_ns(at(4 * TEN_NS)) == 4 * TEN_NS
    time.tick(at(10 * SECOND_NS, tick(hour), writer=2))
    assert time.stamp_ns(at(10 * SECOND_NS)) == hour


def heard(steady_s, wall_s=None, topic="/words", said=b""):
    """Return a message that came at a steady time, and at a wall time."""
    steady_ns = round(steady_s * SECOND_NS)
    wall_ns = steady_ns if wall_s is None else round(wall_s * SECOND_NS)
    return Received(topic, wall_ns, wall_ns, steady_ns, 1, said)


def ticked(steady_s, now_s, wall_s=None):
    return heard(steady_s, wall_s, CLOCK_TOPIC, tick(round(now_s * SECOND_NS)))


def stretches(time, messages, at_once=3):
    """Return the stamps [s] of each stretch between steps, and the reasons of the steps."""
    stamps, reasons = [[]], []
    for first in range(0, len(messages), at_once):
        for each in time.stamped(messages[first : first + at_once]):
            if isinstance(each, Step):
                stamps.append([])
                reasons.append(each.reason)
            else:
                stamps[-1].append(each.stamp_ns / SECOND_NS)
    return stamps, reasons


@pytest.mark.parametrize("jump_s", [1.7e9, 3600.0, -3600.0, 5.1, -5.1])
def test_a_wall_clock_that_is_set_is_a_step_whatever_the_direction(jump_s):
    before = [heard(t, 1e5 + t) for t in range(4)]
    after = [heard(t, 1e5 + t + jump_s) for t in range(4, 8)]
    (first, second), (reason,) = stretches(RobotTime(simulated=False), before + after)
    assert first == [1e5 + t for t in range(4)]
    assert second == [1e5 + t + jump_s for t in range(4, 8)]
    assert f"{abs(jump_s):.1f} s" in reason


@given(st.lists(st.floats(-4.9, 4.9), min_size=1, max_size=20))
def test_small_corrections_of_the_wall_clock_are_no_step_and_time_never_runs_back(offsets_s):
    offsets_s = [max(-2.4, min(2.4, each)) for each in offsets_s]
    messages = [heard(t, 1e5 + t + offset) for t, offset in enumerate(offsets_s)]
    (stamps,), reasons = stretches(RobotTime(simulated=False), messages)
    assert not reasons
    assert len(stamps) == len(messages)
    assert stamps == sorted(stamps)


def test_time_that_passes_without_messages_is_no_step():
    (stamps,), reasons = stretches(RobotTime(simulated=False), [heard(0.0), heard(3600.0)])
    assert not reasons
    assert stamps == [0.0, 3600.0]


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
@pytest.mark.parametrize("begins_s", [0.0, 1.7e9])
def test_a_clock_that_jumps_is_a_step_and_one_that_is_fast_or_loses_ticks_is_not(speed, begins_s):
    times = [t * 0.1 for t in range(100) if not 40 < t < 60]
    ticks = [ticked(t, 50.0 + speed * t) for t in times]
    jumped = [ticked(10.0 + t, begins_s + speed * t) for t in times]
    (first, second), (reason,) = stretches(RobotTime(simulated=True), ticks + jumped)
    assert first == sorted(first)
    assert first[-1] < 60 + speed * 10
    assert second[0] == begins_s
    assert second[-1] == pytest.approx(begins_s + speed * times[-1])
    assert "/clock was set" in reason


def test_messages_around_a_step_belong_to_their_side_of_it():
    messages = [
        ticked(0.0, 0.0), ticked(0.1, 0.1), heard(0.15), ticked(0.2, 1.7e9), heard(0.25),
        ticked(0.3, 1.7e9 + 0.1),
    ]  # fmt: skip
    (first, second), _ = stretches(RobotTime(simulated=True), messages, at_once=10)
    assert first == pytest.approx([0.0, 0.1, 0.15])
    assert second == pytest.approx([1.7e9, 1.7e9 + 0.05, 1.7e9 + 0.1])


def test_a_clock_that_never_ticks_gives_way_to_wall_time_after_5_s():
    messages = [heard(0.1 * t, 1e5 + 0.1 * t) for t in range(80)]
    (nothing, stamps), (reason,) = stretches(RobotTime(simulated=True), messages)
    assert not nothing
    assert len(stamps) == 80
    assert stamps[0] == 1e5
    assert "wall time" in reason


def test_no_more_messages_wait_for_a_clock_than_the_queue_may_hold(monkeypatch):
    monkeypatch.setattr("oracle_pipeline.live.time_base.QUEUE_BYTES", 1000)
    messages = [heard(0.001 * t, said=b"x" * 100) for t in range(20)]
    (_, stamps), (reason,) = stretches(RobotTime(simulated=True), messages)
    assert len(stamps) == 20
    assert "wall time" in reason


def test_a_clock_that_dies_gives_way_to_wall_time_and_one_that_comes_back_counts_again():
    alive = [each for t in range(20) for each in (ticked(0.1 * t, 0.1 * t), heard(0.1 * t + 0.05))]
    dead = [heard(2.0 + 0.1 * t, 1e5) for t in range(80)]
    again = [ticked(10.0 + 0.1 * t, 2.0 + 0.1 * t, 1e5) for t in range(20)]
    stamps, reasons = stretches(RobotTime(simulated=True), alive + dead + again)
    assert len(reasons) == 2
    assert sum(map(len, stamps)) == len(alive + dead + again)
    assert stamps[0][-1] < 2.2
    assert set(stamps[1]) == {1e5}
    assert stamps[2][-1] == pytest.approx(3.9)
