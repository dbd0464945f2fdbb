"""Messages that a topic repeats in a row are known from those that are equal by chance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.scoring.contract import FEWEST_RECORDINGS, REPLAYED, Contract, Observation
from oracle_pipeline.scoring.fingerprints import DIFFERENT, longest_repeat
from tests.oracle_pipeline.features.scenery import odometry_message, scan_message

COUNT = 200
TOPIC = {"/odom": ("nav_msgs/msg/Odometry", (), None)}


def odometry(number, time_s=0.0):
    return odometry_message(time_s, 0.1j * number, 0.0)


@pytest.fixture
def repeats_of(observer_of):
    return lambda recorded: observer_of(recorded).fingerprints.repeats()


def replayed(first, length, at):
    """Return what is published if messages from `first` on come again, `at` a later place."""
    numbers = [*range(at), *range(first, first + length), *range(at + length, COUNT)]
    return [(float(i), "/odom", odometry(n, float(i))) for i, n in enumerate(numbers)]


def test_no_message_of_a_robot_that_moves_comes_again(repeats_of):
    assert repeats_of(replayed(0, 0, 0)) == {"/odom": 0}


@pytest.mark.parametrize(("first", "length", "at"), [(0, 12, 50), (30, 40, 70), (5, 1, 150)])
def test_a_replay_is_found_whatever_its_stamps_are(repeats_of, first, length, at):
    assert repeats_of(replayed(first, length, at)) == {"/odom": length}


def test_large_messages_are_compared_too(repeats_of):
    rng = np.random.default_rng(0)
    scans = [scan_message(i, "laser", rng.uniform(0.5, 3.0, 2000)) for i in range(COUNT)]
    scans[80:100] = scans[20:40]
    assert repeats_of([(float(i), "/scan", s) for i, s in enumerate(scans)]) == {"/scan": 20}


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
    assert longest_repeat(sequence + again) == (length if length + gap > 1 else 0)


@given(st.lists(st.integers(0, 3), max_size=60))
def test_a_sequence_is_no_longer_than_half_of_all_messages(contents):
    assert 0 <= longest_repeat(contents) <= len(contents) // 2


@given(st.integers(1, 10), st.integers(1, 10))
def test_waiting_is_no_repetition(states, messages):
    assert longest_repeat(np.repeat(np.arange(states), messages)) == 0


def told(usual, longest, recordings=FEWEST_RECORDINGS):
    normal = [Observation(TOPIC, None, repeats={"/odom": usual})] * recordings
    seen = Observation(TOPIC, None, repeats={"/odom": longest})
    return [breach.text for breach in Contract.learned(normal).breaches(seen)]


def test_a_replay_breaks_the_contract():
    assert told(0, REPLAYED) == [
        f"Topic /odom repeats {REPLAYED} of its messages in a row; in normal recordings at most 0."
    ]
    assert told(0, REPLAYED - 1) == []


def test_topics_that_repeat_themselves_may_do_so_in_another_recording():
    assert told(20, 2 * 20 + REPLAYED) == []
    assert told(20, 3 * 20 + REPLAYED) != []


def test_a_few_recordings_do_not_tell_what_is_repeated():
    assert told(0, 99, FEWEST_RECORDINGS - 1) == []
    normal = [Observation(TOPIC, None, repeats={"/odom": 0})] * FEWEST_RECORDINGS
    differing = Contract.learned([*normal, Observation(TOPIC, None)])
    assert differing.breaches(Observation(TOPIC, None, repeats={"/odom": 99})) == []
