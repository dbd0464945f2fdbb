"""A running robot that breaches the contract of normal recordings is reported within seconds."""

from dataclasses import replace

import pytest

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_discovery import DdsDiscovery
from oracle_pipeline.graphs.intervals import compose
from oracle_pipeline.live.contract_watch import CONSECUTIVE, STARTUP_S, ContractWatch
from oracle_pipeline.live.graph_snapshot import snapshot
from oracle_pipeline.scoring.contract import Contract, Observation, graph_elements, qos_words
from oracle_pipeline.scoring.fingerprints import MESSAGES
from oracle_pipeline.scoring.pace import Pace
from sim.middleware.qos import DEFAULT, SENSOR_DATA
from tests.oracle_pipeline.live.robots import STRING, TEXT, Robot

pytestmark = pytest.mark.slow

PERIOD_S = 0.1
WORDS = "/words"


@pytest.fixture
def robot(domain):
    return (
        Robot(domain).node("talker", publishes=[WORDS]).node("ear", subscribes=[WORDS]).announce()
    )


@pytest.fixture
def watched(domain, robot, eventually):
    """Discovery of the robot, and the contract that the robot keeps."""
    participant = dds.join(domain)
    discovery = DdsDiscovery(participant)

    def is_known():
        discovery.update()
        return discovery.node_names() == ["/ear", "/talker"] and WORDS in discovery.topics()

    assert eventually(is_known)
    yield discovery, contract_of(discovery)
    dds.leave(participant)


def contract_of(discovery):
    per_span = round(10 / PERIOD_S)
    observation = Observation(
        {WORDS: (STRING, qos_words([DEFAULT]), 1 / PERIOD_S)},
        graph_elements(compose([snapshot(discovery, {})])),
        {WORDS: Pace(2 * PERIOD_S, per_span, per_span)},
    )
    return Contract.learned([observation])


def watch_of(contract):
    return ContractWatch(contract, {WORDS: STRING, "/spy": STRING})


def reported(watch, discovery, *, from_s=0, to_s=20, period_s=PERIOD_S, message=lambda _: TEXT):
    """Return when each breach is first reported; messages come at a period, None: not at all."""
    found, next_s = {}, float(from_s)
    for now_s in range(from_s + 1, to_s + 1):
        while period_s is not None and next_s < now_s:
            watch.add(WORDS, next_s, message(next_s))
            next_s += period_s
        discovery.update()
        for breach in watch.check(float(now_s), discovery):
            assert breach.text not in found
            found[breach.text] = now_s
    return found


def test_a_robot_that_keeps_the_contract_has_no_breach(watched):
    discovery, contract = watched
    assert watch_of(contract).is_whole(snapshot(discovery, {}))
    assert reported(watch_of(contract), discovery, to_s=100) == {}


def test_a_robot_is_up_once_its_steady_topics_came_or_a_minute_has_passed(watched):
    discovery, contract = watched
    watch = watch_of(contract)
    assert reported(watch, discovery, to_s=10, period_s=None) == {}
    assert not watch.is_up(9.0)
    assert reported(watch, discovery, from_s=10, to_s=20) == {}
    assert not watch.is_up(5.0)
    assert watch.is_up(10.0)
    assert watch_of(contract).is_up(STARTUP_S)


@pytest.mark.parametrize("spaces", [("/robot1",), ("/robot1", "/robot2")])
def test_topics_in_the_namespace_of_a_robot_are_its_own(domain, eventually, spaces):
    topics = {"/odom": "nav_msgs/msg/Odometry", "/scan": "sensor_msgs/msg/LaserScan"}
    normal = Observation(
        {name: (msgtype, qos_words([DEFAULT]), 10.0) for name, msgtype in topics.items()}, None,
        {name: Pace(0.2, 100, 100) for name in topics},
    )  # fmt: skip
    robots = [Robot(domain, space) for space in spaces]
    for robot in robots:
        for name, msgtype in topics.items():
            robot.node("driver", publishes=[name], msgtype=msgtype)
        robot.announce()
    discovery = DdsDiscovery(dds.join(domain))
    types = {space + name: topics[name] for space in spaces for name in topics}
    known = types.keys()
    assert eventually(lambda: discovery.update() or known <= discovery.topics().keys())
    watch, texts = ContractWatch(Contract.learned([normal]), types), []
    for now_s in range(1, 80):
        for name in known if now_s < 70 else known - {f"{spaces[-1]}/scan"}:
            for tenth in range(10):
                watch.add(name, now_s - 1 + tenth / 10, TEXT)
        texts += [each.text for each in watch.check(float(now_s), discovery)]
    (text,) = texts
    assert text.startswith("robot2: Topic /scan" if spaces[1:] else "Topic /scan")


def test_a_topic_that_falls_silent_is_reported_within_seconds_and_once(watched):
    discovery, contract = watched
    watch = watch_of(contract)
    assert reported(watch, discovery, to_s=30) == {}
    ((text, at_s),) = reported(watch, discovery, from_s=30, to_s=90, period_s=None).items()
    assert "/words has been silent" in text
    assert at_s - 30 <= 4


@pytest.mark.parametrize("period_s", [PERIOD_S / 2, PERIOD_S * 2])
def test_another_rate_is_reported_within_a_span(watched, period_s):
    discovery, contract = watched
    watch = watch_of(contract)
    assert reported(watch, discovery, to_s=30) == {}
    ((text, at_s),) = reported(watch, discovery, from_s=30, to_s=60, period_s=period_s).items()
    assert "/words has" in text
    assert at_s - 30 <= 10


def test_messages_that_come_again_are_reported_within_seconds_and_once(watched):
    discovery, contract = watched
    watch = watch_of(replace(contract, repeats={WORDS: {MESSAGES: 1}}))

    def replayed(at_s):
        return str(round(at_s if at_s < 70 else at_s - 20, 3)).encode()

    assert reported(watch, discovery, to_s=70, message=replayed) == {}
    ((text, at_s),) = reported(watch, discovery, from_s=70, to_s=90, message=replayed).items()
    assert text.startswith("Topic /words repeats")
    assert at_s - 70 <= 4
    assert reported(watch, discovery, from_s=110, to_s=200, message=replayed) == {}


def test_a_new_node_is_reported_without_its_edges(watched, robot, eventually):
    discovery, contract = watched
    watch = watch_of(contract)
    other = Robot(robot.domain).node("spy", subscribes=[WORDS], publishes=["/spy"]).announce()
    assert eventually(lambda: discovery.update() or "/spy" in discovery.node_names())
    found = reported(watch, discovery)
    assert set(found) == {"Node /spy is new.", f"Topic /spy ({STRING}) is new."}
    assert set(found.values()) == {CONSECUTIVE}
    assert other


def test_a_node_that_is_gone_is_reported_and_a_robot_that_has_left_is_not(
    watched, robot, eventually
):
    discovery, contract = watched
    watch = watch_of(contract)
    assert reported(watch, discovery) == {}
    del robot.readers["ear", WORDS]
    robot.announce()
    assert eventually(lambda: discovery.update() or discovery.node_names() == ["/talker"])
    assert list(reported(watch, discovery, from_s=20, to_s=30)) == ["Node /ear is gone."]
    assert not watch.is_whole(snapshot(discovery, {}))
    dds.leave(robot.participant)
    assert eventually(lambda: discovery.update() or not discovery.topics())
    assert reported(watch, discovery, from_s=30, to_s=90, period_s=None) == {}


def test_other_qos_is_reported(watched, robot, eventually):
    discovery, contract = watched
    other = Robot(robot.domain).node("talker", publishes=[WORDS], qos=SENSOR_DATA).announce()
    assert eventually(lambda: discovery.update() or len(discovery.topics()[WORDS]) == 2)
    (text,) = reported(watch_of(contract), discovery)
    assert "QoS best effort" in text
    assert other


def test_missing_nodes_are_reported_only_once_a_robot_has_started(watched):
    discovery, contract = watched
    more = replace(
        contract, always=contract.always | {"node:/late"}, ever=contract.ever | {"node:/late"}
    )
    ((text, at_s),) = reported(watch_of(more), discovery, to_s=90).items()
    assert text == "Node /late is gone."
    assert at_s >= STARTUP_S
