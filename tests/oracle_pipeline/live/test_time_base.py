"""The robot's time between the ticks of its clock."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from oracle_pipeline.bags.types import message_class, serialize
from oracle_pipeline.live.intake import Received
from oracle_pipeline.live.time_base import CLOCK_TOPIC, SimulatedTime

SECOND_NS = 10**9
TEN_NS = SECOND_NS // 10
CLOCK = "rosgraph_msgs/msg/Clock"


def tick(now_ns):
    time = message_class("builtin_interfaces/msg/Time")(*divmod(now_ns, SECOND_NS))
    return serialize(message_class(CLOCK)(time), CLOCK)


def at(wall_ns, said=b"", *, later_ns=0, writer=1):
    """Return a message that was sent at a time and came later."""
    return Received(CLOCK_TOPIC, wall_ns, wall_ns + later_ns, writer, said)


@given(st.floats(0.1, 20.0), st.integers(0, 10**12), st.floats(0.0, 0.1))
def test_time_goes_on_as_fast_as_the_clock_does(speed, begin_ns, later_s):
    time, wall_ns = SimulatedTime(), 5 * SECOND_NS
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
    time, wall_ns, stamps = SimulatedTime(), 0, []
    for later_ns, now_ns in said:
        wall_ns += later_ns
        time.tick(at(wall_ns, tick(now_ns)))
        if time.is_ready:
            stamps.append(time.stamp_ns(at(wall_ns)))
    assert stamps == sorted(stamps)


def test_time_stops_with_the_clock():
    time = SimulatedTime()
    time.tick(at(0, tick(0)))
    time.tick(at(SECOND_NS, tick(SECOND_NS)))
    assert time.stamp_ns(at(100 * SECOND_NS)) <= 2 * SECOND_NS
    assert time.stamp_ns(at(200 * SECOND_NS)) == time.stamp_ns(at(300 * SECOND_NS))


def test_one_tick_does_not_determine_the_speed():
    time = SimulatedTime()
    assert not time.is_ready
    time.tick(at(0, tick(0)))
    assert not time.is_ready
    time.tick(at(1, tick(5)))
    assert time.is_ready


@given(st.integers(0, SECOND_NS))
def test_a_message_has_the_time_at_which_it_was_sent_even_if_it_is_late(later_ns):
    time = SimulatedTime()
    for number in range(10):
        time.tick(at(number * TEN_NS, tick(number * SECOND_NS), later_ns=later_ns))
    sent_ns = 4 * TEN_NS + TEN_NS // 4
    assert time.stamp_ns(at(sent_ns, later_ns=later_ns)) == 4 * SECOND_NS + SECOND_NS // 4


def test_where_clocks_of_machines_disagree_it_counts_when_a_message_comes():
    time, hour_ns = SimulatedTime(), 3600 * SECOND_NS
    for number in range(3):
        came_ns = hour_ns + number * SECOND_NS
        time.tick(Received(CLOCK_TOPIC, came_ns + hour_ns, came_ns, 1, tick(number * TEN_NS)))
    came_ns = hour_ns + SECOND_NS
    assert time.stamp_ns(Received("/scan", 0, came_ns, 2, b"")) == TEN_NS


def test_of_two_clocks_the_first_counts_while_it_ticks():
    time = SimulatedTime()
    for number in range(5):
        time.tick(at(number * TEN_NS, tick(number * TEN_NS)))
        time.tick(at(number * TEN_NS + 1, tick(hour := 3600 * SECOND_NS), writer=2))
    assert time.stamp_ns(at(4 * TEN_NS)) == 4 * TEN_NS
    time.tick(at(10 * SECOND_NS, tick(hour), writer=2))
    assert time.stamp_ns(at(10 * SECOND_NS)) == hour
