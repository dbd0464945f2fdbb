"""The picture of a domain: nodes, topics and profiles of exactly the existing participants."""

import multiprocessing

import pytest
from rosbags.typesys import Stores

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.dds_discovery import DdsDiscovery
from oracle_pipeline.bags.discovery import UNKNOWN_NODE
from oracle_pipeline.bags.graph_files import vertex_id
from oracle_pipeline.live.graph_snapshot import snapshot
from sim.middleware.qos import LATCHED
from tests.oracle_pipeline.live.robots import STRING, Robot


@pytest.fixture
def discovery(domain):
    return DdsDiscovery(dds.join(domain))


def edges(discovery):
    discovery.update()
    return set(snapshot(discovery, {}).edges)


def edge(*ends):
    return tuple(vertex_id(*end.split(":", 1)) for end in ends)


@pytest.mark.parametrize("release", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_nodes_and_their_endpoints_are_found(domain, discovery, eventually, release):
    robot = Robot(domain, release=release)
    robot.node("talker", publishes=["/words"], qos=LATCHED).announce()
    robot.node("listener", subscribes=["/words"], qos=LATCHED).announce()
    expected = {edge("node:/talker", "topic:/words"), edge("topic:/words", "node:/listener")}
    eventually(lambda: edges(discovery) == expected)
    (publisher,) = discovery.topics()["/words"]
    assert (publisher.msgtype, publisher.qos) == (STRING, LATCHED)


def test_an_endpoint_that_no_node_claims_is_not_hidden(domain, discovery, eventually):
    robot = Robot(domain).node("stranger", publishes=["/words"])
    eventually(lambda: edges(discovery) == {edge(f"node:{UNKNOWN_NODE}", "topic:/words")})
    assert discovery.node_names() == [UNKNOWN_NODE]
    robot.announce()
    eventually(lambda: edges(discovery) == {edge("node:/stranger", "topic:/words")})


def test_two_robots_with_namespaces_are_two(domain, discovery, eventually):
    robots = [
        Robot(domain, name).node("driver", publishes=["/scan"], subscribes=["/go"]).announce()
        for name in ("/robot1", "/robot2")
    ]
    expected = {
        way
        for name in (robot.namespace for robot in robots)
        for way in (
            edge(f"node:{name}/driver", f"topic:{name}/scan"),
            edge(f"topic:{name}/go", f"node:{name}/driver"),
        )
    }
    eventually(lambda: edges(discovery) == expected)


def test_domains_do_not_see_each_other(domain, other_domain, discovery, eventually):
    other = Robot(other_domain).node("elsewhere", publishes=["/there"]).announce()
    here = Robot(domain).node("talker", publishes=["/here"]).announce()
    eventually(lambda: edges(discovery) == {edge("node:/talker", "topic:/here")})
    assert other.writers
    assert here.writers


def _robot_that_is_killed(domain, ready):
    robot = Robot(domain).node("doomed", publishes=["/last_words"]).announce()
    ready.set()
    multiprocessing.Event().wait()
    assert robot


@pytest.mark.slow
def test_a_node_that_dies_is_removed_when_its_lease_ends(domain, discovery, eventually):
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    process = context.Process(target=_robot_that_is_killed, args=(domain, ready), daemon=True)
    process.start()
    ready.wait()
    eventually(lambda: edges(discovery) == {edge("node:/doomed", "topic:/last_words")})
    process.kill()
    eventually(lambda: not edges(discovery) and not discovery.node_names())


@pytest.mark.slow
def test_a_hundred_nodes_and_three_hundred_topics_are_all_found(domain, discovery, eventually):
    robots = []
    for part in range(4):
        robot = Robot(domain)
        for number in range(part * 25, part * 25 + 25):
            topics = [f"/node{number}/topic{each}" for each in range(3)]
            robot.node(
                f"node{number}", publishes=topics, subscribes=[f"/node{(number + 1) % 100}/topic0"]
            )
        robots.append(robot.announce())
    eventually(lambda: len(edges(discovery)) == 400, seconds=30.0)
    assert len(discovery.node_names()) == 100
    assert len(discovery.topics()) == 300
    assert len(robots) == 4
