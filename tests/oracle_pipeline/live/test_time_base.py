"""The robot's time between the ticks of its clock."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from oracle_pipeline.bags.types import message_class, serialize
from oracle_pipeline.live.time_base import SimulatedTime

SECOND_NS = 10**9
CLOCK = "rosgraph_msgs/msg/Clock"


def tick(now_ns):
    time = message_class("builtin_interfaces/msg/Time")(*divmod(now_ns, SECOND_NS))
    return serialize(message_class(CLOCK)(time), CLOCK)


@given(st.floats(0.1, 20.0), st.integers(0, 10**12), st.floats(0.0, 0.1))
def test_time_goes_on_as_fast_as_the_clock_does(speed, begin_ns, later_s):
    time, wall_ns = SimulatedTime(), 5 * SECOND_NS
    period_ns = SECOND_NS // 10
    for number in range(10):
        time.hear(wall_ns + number * period_ns, tick(begin_ns + round(number * period_ns * speed)))
    last_ns = wall_ns + 9 * period_ns
    expected = begin_ns + speed * (9 * period_ns + later_s * SECOND_NS)
    assert time.stamp_ns(last_ns + round(later_s * SECOND_NS)) == pytest.approx(expected, abs=100)


ticks = st.tuples(st.integers(1, SECOND_NS), st.integers(0, 100 * SECOND_NS))


@given(st.lists(ticks, min_size=3, max_size=30))
def test_stamps_never_run_back_whatever_the_clock_says(said):
    time, wall_ns, stamps = SimulatedTime(), 0, []
    for later_ns, now_ns in said:
        wall_ns += later_ns
        time.hear(wall_ns, tick(now_ns))
        if time.is_ready:
            stamps.append(time.stamp_ns(wall_ns))
    assert stamps == sorted(stamps)


def test_a_clock_that_stands_stops_time():
    time = SimulatedTime()
    time.hear(0, tick(0))
    time.hear(SECOND_NS, tick(SECOND_NS))
    assert time.stamp_ns(100 * SECOND_NS) <= 2 * SECOND_NS
    assert time.stamp_ns(200 * SECOND_NS) == time.stamp_ns(300 * SECOND_NS)


def test_one_tick_does_not_tell_the_speed():
    time = SimulatedTime()
    assert not time.is_ready
    time.hear(0, tick(0))
    assert not time.is_ready
    time.hear(1, tick(5))
    assert time.is_ready
