import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.scoring.contract import FEWEST_RECORDINGS, Contract, Observation
from oracle_pipeline.scoring.fingerprints import Copies
from oracle_pipeline.scoring.pace import FEWEST
from tests.oracle_pipeline.features.scenery import odometry_message, scan_message

COUNT = 2 * FEWEST


def scan(number, offset=0.0):
    return scan_message(number, "laser", np.full(8, 1.0 + number + offset))


def odometry(number):
    return odometry_message(number, 0.1j * number, 0.0)


@pytest.fixture
def relays_of(observer_of):
    return lambda recorded: observer_of(recorded).fingerprints.relays()


def test_messages_that_are_published_again_are_copies(relays_of):
    recorded = [(float(i), "/scan", scan(i)) for i in range(COUNT)]
    recorded += [(i + 0.1, "/relayed", scan(i, 0.5 if i < 3 else 0.0)) for i in range(COUNT)]
    recorded += [(float(i), "/odom", odometry(i)) for i in range(COUNT)]
    part = Copies(COUNT - 3, COUNT)
    assert relays_of(recorded) == {"/scan": {}, "/relayed": {"/scan": part}}


def test_of_two_topics_with_equal_messages_at_once_one_is_the_source(relays_of):
    recorded = [(float(i), name, scan(i)) for i in range(COUNT) for name in ("/scan", "/copy")]
    assert relays_of(recorded) == {"/copy": {}, "/scan": {"/copy": Copies(COUNT, COUNT)}}


def test_topics_with_few_different_messages_are_equal_by_chance(relays_of):
    still = [(float(i), name, scan(0)) for i in range(COUNT) for name in ("/scan", "/other")]
    assert relays_of(still) == {}


def test_a_message_of_another_type_is_never_a_copy(relays_of):
    recorded = [(float(i), "/scan", scan(i)) for i in range(COUNT)]
    assert relays_of(recorded + [(float(i), "/odom", odometry(i)) for i in range(COUNT)]) == {}


def observed(equal=0, count=100, topics=("/plan", "/received")):
    sources = {"/plan": Copies(equal, count)} if equal else {}
    return Observation(
        dict.fromkeys(topics, ("nav_msgs/msg/Path", (), None)), None, relays={"/received": sources}
    )


def told(normal, seen):
    return [breach.text for breach in Contract.learned(normal).breaches(seen)]


NORMAL = [observed(count - 1, count) for count in range(100, 100 + FEWEST_RECORDINGS)]


def test_a_relay_whose_messages_are_altered_is_a_breach():
    assert told(NORMAL, observed(91)) == [
        "Of the messages on topic /received, 91.0% are copies of messages on /plan; in normal "
        "recordings at least 99.0% are."
    ]
    assert told(NORMAL, observed()) != []


def test_a_relay_may_lose_somewhat_more_than_in_normal_recordings():
    assert told(NORMAL, observed(94)) == []


def test_a_relay_needs_its_source_and_enough_recordings():
    assert told(NORMAL[1:], observed()) == []
    gone = "Topic /plan is gone: every normal recording has it."
    assert told(NORMAL, observed(topics=["/received"])) == [gone]


@given(st.integers(FEWEST, 1000), st.floats(0.0, 1.0))
def test_topics_that_are_seldom_copies_are_no_relay(count, share):
    seldom = observed(min(int(0.7 * count), int(share * count)), count)
    normal = [*NORMAL, seldom]
    assert told(normal, observed(0, count)) == []
