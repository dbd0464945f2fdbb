import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.middleware.executor import Executor


@given(st.lists(st.integers(0, 1000)))
def test_callbacks_run_in_time_order_and_ties_in_the_order_of_scheduling(times):
    executor, ran = Executor(), []
    for index, time_ns in enumerate(times):
        executor.call_at(time_ns, lambda *entry: ran.append(entry), time_ns, index)
    executor.run_until(1000)
    assert ran == sorted((t, i) for i, t in enumerate(times))
    assert executor.now_ns == 1000


def test_the_world_is_advanced_before_any_callback_of_an_instant():
    seen = []
    executor = Executor(on_advance=lambda t: seen.append(("world", t)))
    executor.call_at(5, lambda: seen.append(("node", executor.now_ns)))
    executor.run_until(8)
    assert seen == [("world", 5), ("node", 5), ("world", 8)]


def test_a_callback_cannot_be_scheduled_in_the_past():
    executor = Executor()
    executor.run_until(10)
    with pytest.raises(ValueError, match="cannot schedule at 9 ns"):
        executor.call_at(9, lambda: None)


def test_the_executor_stops_when_the_condition_holds():
    executor, ran = Executor(), []
    for time_ns in (1, 2, 3):
        executor.call_at(time_ns, ran.append, time_ns)
    executor.run_until(10, stop=lambda: len(ran) == 2)
    assert (ran, executor.now_ns) == ([1, 2], 2)
