"""Messages that a topic repeats in a row are known from those that are equal by chance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import message_class, serialize
from oracle_pipeline.scoring.contract import FEWEST_RECORDINGS, REPLAYED, Contract, Observation
from oracle_pipeline.scoring.fingerprints import (
    DIFFERENT,
    MESSAGES,
    RECENT,
    RecentRepeats,
    longest_repeat,
)
from tests.oracle_pipeline.features.scenery import odometry_message, scan_message

COUNT = 200
vector = message_class("geometry_msgs/msg/Vector3")
TOPIC = {"/odom": ("nav_msgs/msg/Odometry", (), None)}


def odometry(number, time_s=0.0):
    return odometry_message(time_s, 0.1j * number, 0.0)


@pytest.fixture
def repeats_of(observer_of):
    """What a recorded topic repeats at most in a row: its messages, and its numbers."""

    def found(recorded):
        observer = observer_of(recorded)
        times_ns = np.array([round(time_s * 1e9) for time_s, _, _ in recorded])
        return observer.fingerprints.repeats(observer.signals.signals(times_ns))

    return found


def replayed(first, length, at):
    """Return what is published if messages from `first` on come again, `at` a later place."""
    numbers = [*range(at), *range(first, first + length), *range(at + length, COUNT)]
    return [(float(i), "/odom", odometry(n, float(i))) for i, n in enumerate(numbers)]


def test_no_message_of_a_robot_that_moves_comes_again(repeats_of):
    assert repeats_of(replayed(0, 0, 0)) == {"/odom": {MESSAGES: 0}}


@pytest.mark.parametrize(("first", "length", "at"), [(0, 12, 50), (30, 40, 70), (5, 1, 150)])
def test_a_replay_is_found_whatever_its_stamps_are(repeats_of, first, length, at):
    assert repeats_of(replayed(first, length, at)) == {"/odom": {MESSAGES: length}}


def test_large_messages_are_compared_too(repeats_of):
    rng = np.random.default_rng(0)
    scans = [scan_message(i, "laser", rng.uniform(0.5, 3.0, 2000)) for i in range(COUNT)]
    scans[80:100] = scans[20:40]
    found = repeats_of([(float(i), "/scan", s) for i, s in enumerate(scans)])
    assert found["/scan"][MESSAGES] == 20


def test_a_number_that_is_replayed_is_found_in_messages_that_are_not(repeats_of):
    rng = np.random.default_rng(0)
    measured = rng.normal(size=(COUNT, 3))
    measured[100:130, 1] = measured[40:70, 1]
    found = repeats_of([(float(i), "/force", vector(*row)) for i, row in enumerate(measured)])
    assert found == {"/force": {MESSAGES: 0, "x": 0, "y": 30, "z": 0}}


@pytest.mark.parametrize("step", [0.01, 1e-9])
def test_a_rounded_number_repeats_by_chance(repeats_of, step):
    rng = np.random.default_rng(0)
    once = np.cumsum(rng.uniform(0.01, 0.03, COUNT // 2))
    twice = np.round(np.tile(once, 2) / step) * step  # a robot that drives the same way twice
    found = repeats_of([(float(i), "/a", vector(x, 0.0, 0.0)) for i, x in enumerate(twice)])
    assert found["/a"].get("x") == (None if step == 0.01 else COUNT // 2)


def test_a_topic_with_few_states_is_not_compared(repeats_of):
    assert (
        repeats_of([(float(i), "/odom", odometry(i % (DIFFERENT - 1))) for i in range(COUNT)]) == {}
    )


@given(
    st.integers(1, 40), st.integers(0, 40), st.integers(0, 20), st.randoms(use_true_random=False)
)
def test_what_is_between_repeated_messages_does_not_hide_them(length, gap, others, random):
    sequence = [*range(length), *range(1000, 1000 + gap)]
    again = [*range(length), *range(2000, 2000 + others)]
    again.sort(key=lambda n: n if n < 1000 else random.uniform(0, length))
    repeated = [n for n in again if n < 1000]
    assert repeated == [*range(length)]
    assert len(longest_repeat(sequence + again)) == (length if length + gap > 1 else 0)


@given(st.lists(st.integers(0, 3), max_size=60))
def test_a_sequence_is_no_longer_than_half_of_all_messages(contents):
    assert 0 <= len(longest_repeat(contents)) <= len(contents) // 2


@given(st.integers(1, 10), st.integers(1, 10))
def test_waiting_is_no_repetition(states, messages):
    assert len(longest_repeat(np.repeat(np.arange(states), messages))) == 0


def repeated(numbers):
    recent = RecentRepeats("std_msgs/msg/UInt32")
    return max(recent.add(number.to_bytes(8)) for number in numbers)


@given(st.lists(st.integers(0, 6), max_size=60))
def test_a_running_topic_repeats_what_its_recording_does(contents):
    numbers = [*range(100, 100 + DIFFERENT), *contents]
    assert repeated(numbers) == len(longest_repeat(numbers))


def test_a_running_topic_is_compared_with_as_many_messages_as_fit():
    numbers = [*range(2 * RECENT)]
    assert repeated([*numbers, *range(RECENT, RECENT + 10)]) == 10
    assert repeated([*numbers, *range(RECENT - 10, RECENT)]) == 0


def test_a_running_topic_is_replayed_under_new_stamps():
    recent = RecentRepeats("nav_msgs/msg/Odometry")
    numbers = [*range(DIFFERENT), *range(20)]
    published = [odometry(number, time_s) for time_s, number in enumerate(numbers)]
    added = [recent.add(serialize(each, "nav_msgs/msg/Odometry")) for each in published]
    assert added[-20:] == [*range(1, 21)]


def told_of(usual, seen, recordings=FEWEST_RECORDINGS):
    normal = [Observation(TOPIC, None, repeats={"/odom": usual})] * recordings
    recording = Observation(TOPIC, None, repeats={"/odom": seen})
    return [breach.text for breach in Contract.learned(normal).breaches(recording)]


def told(usual, longest, recordings=FEWEST_RECORDINGS):
    return told_of({MESSAGES: usual}, {MESSAGES: longest}, recordings)


def test_a_replay_breaks_the_contract():
    assert told(0, REPLAYED) == [
        f"Topic /odom repeats {REPLAYED} of its messages in a row; in normal recordings at most 0."
    ]
    assert told(0, REPLAYED - 1) == []


def test_numbers_are_named_where_messages_are_not_replayed():
    usual, seen = dict.fromkeys(["x", "y", "z"], 2), {MESSAGES: 3, "x": 20, "y": 30, "z": 15}
    (breach,) = told_of({MESSAGES: 0, **usual}, seen)
    assert breach == "Topic /odom repeats 30 of x, y in a row; in normal recordings at most 2."
    assert told_of({"x": 2}, seen) == [breach.replace("30 of x, y", "20 of x")]
    assert told_of({MESSAGES: 0, **usual}, {**seen, MESSAGES: 12}) == [
        "Topic /odom repeats 12 of its messages in a row; in normal recordings at most 0."
    ]


def test_topics_that_repeat_themselves_may_do_so_in_another_recording():
    assert told(20, 2 * 20 + REPLAYED) == []
    assert told(20, 3 * 20 + REPLAYED) != []


def test_a_few_recordings_do_not_tell_what_is_repeated():
    assert told(0, 99, FEWEST_RECORDINGS - 1) == []
    normal = [Observation(TOPIC, None, repeats={"/odom": {MESSAGES: 0}})] * FEWEST_RECORDINGS
    differing = Contract.learned([*normal, Observation(TOPIC, None)])
    assert differing.breaches(Observation(TOPIC, None, repeats={"/odom": {MESSAGES: 99}})) == []
