"""Graphs from rclpy's lists: those that the testbed's own recorder writes, without rclpy."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import networkx as nx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_graph_recorder.interval_graphs import IntervalGraphs, Traffic, _divided, snapshot
from oracle_pipeline.bags.graph_files import RosGraph, read_gexf
from oracle_pipeline.bags.qos_profiles import compatible
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.graphs.intervals import compose, read_intervals
from sim.middleware.domain import Domain
from sim.middleware.endpoints import Publisher, Subscription
from sim.recording import GraphRecorder
from tests.sim.system import System

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Info:
    """The used part of rclpy's TopicEndpointInfo."""

    node_name: str
    node_namespace: str
    qos_profile: Any


class AsRclpy:
    """The testbed's domain behind the calls of an rclpy node."""

    def __init__(self, domain: Domain) -> None:
        self.domain = domain

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [_split(name) for name in self.domain.node_names()]

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [(name, [msgtype]) for name, msgtype in self.domain.topics.items()]

    def get_publishers_info_by_topic(self, topic_name: str) -> list[Info]:
        return [_info(each) for each in self.domain.publishers(topic_name)]

    def get_subscriptions_info_by_topic(self, topic_name: str) -> list[Info]:
        return [_info(each) for each in self.domain.subscriptions(topic_name)]


def _split(full: str) -> tuple[str, str]:
    namespace, _, name = full.rpartition("/")
    return name, namespace or "/"


def _info(endpoint: Publisher | Subscription) -> Info:
    return Info(*_split(endpoint.node), endpoint.qos)


def sent(domain: Domain) -> dict[str, tuple[int, int]]:
    """Return messages and bytes that were sent on each topic so far."""
    counts: dict[str, tuple[int, int]] = {}
    for publisher in domain.publishers():
        messages, size = counts.get(publisher.topic, (0, 0))
        counts[publisher.topic] = messages + publisher.messages, size + publisher.message_bytes
    return counts


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[RosGraph, RosGraph]:
    """The graph of one interval by the testbed's recorder, and from rclpy's lists."""
    folder = tmp_path_factory.mktemp("graphs")
    system = System()
    system.activate()
    with BagWriter(tmp_path_factory.mktemp("bag") / "bag") as bag:
        system.complete(bag)
        before = sent(system.domain)
        recorder = GraphRecorder(system.domain, folder)
        system.run(6.0)
        traffic = Traffic()
        for topic, (messages, size) in sent(system.domain).items():
            known = before.get(topic, (0, 0))
            traffic.messages[topic] = messages - known[0]
            traffic.bytes[topic] = size - known[1]
        recorder.finish()
        return read_gexf(folder / "000000.gexf"), snapshot(
            AsRclpy(system.domain), traffic, compatible
        )


def test_the_graph_has_the_vertices_and_edges_that_the_recorder_sees(
    recorded: tuple[RosGraph, RosGraph],
) -> None:
    ours, from_lists = recorded
    assert dict(from_lists.nodes(data=True)) == dict(ours.nodes(data=True))
    assert set(from_lists.edges) == set(ours.edges)


def test_a_lone_publisher_has_the_messages_and_bytes_that_it_sent(
    recorded: tuple[RosGraph, RosGraph],
) -> None:
    ours, from_lists = recorded
    lone = [
        (source, target)
        for source, target in ours.edges
        if ours.nodes[target]["kind"] == "topic" and ours.in_degree(target) == 1
    ]
    assert len(lone) > 20
    assert {edge: from_lists.edges[edge] for edge in lone} == {
        edge: ours.edges[edge] for edge in lone
    }


def test_the_traffic_of_publishers_adds_up_to_that_of_the_topic(
    recorded: tuple[RosGraph, RosGraph],
) -> None:
    ours, from_lists = recorded
    topics = [v for v, kind in ours.nodes(data="kind") if kind == "topic" and ours.in_degree(v)]
    for measure in ("messages", "bytes"):
        assert {v: from_lists.in_degree(v, weight=measure) for v in topics} == {
            v: ours.in_degree(v, weight=measure) for v in topics
        }


@given(st.integers(0, 10_000), st.integers(1, 50))
def test_shares_are_nearly_equal_and_add_up(total: int, parts: int) -> None:
    shares = _divided(total, parts)
    assert sum(shares) == total
    assert max(shares) - min(shares) <= 1


class Small:
    """A domain of two robots, a tool, an endpoint that no node claims, and a hidden topic."""

    reliable, best_effort = "reliable", "best effort"

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [("driver", "/a"), ("driver", "/b"), ("oracle_graph_recorder", "/")]

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        names = ("/a/scan", "/b/scan", "/nav/_action/status", "/only_heard_by_us")
        return [(name, ["pkg/msg/T"]) for name in names]

    def get_publishers_info_by_topic(self, topic_name: str) -> list[Info]:
        if topic_name == "/only_heard_by_us":
            return []
        return [Info("driver", topic_name[:2], self.best_effort)]

    def get_subscriptions_info_by_topic(self, topic_name: str) -> list[Info]:
        ours = Info("oracle_graph_recorder", "/", self.best_effort)
        unknown = Info("_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_", self.reliable)
        return [ours, unknown] if topic_name == "/b/scan" else [ours]


def fits(offered: str, requested: str) -> bool:
    return offered == Small.reliable or requested == Small.best_effort


def test_namespaces_unknown_nodes_hidden_topics_and_our_own_node() -> None:
    traffic = Traffic()
    for topic in ("/a/scan", "/b/scan", "/b/scan"):
        traffic.count(topic, 100)
    graph = snapshot(Small(), traffic, fits, leave_out={"/oracle_graph_recorder"})
    assert set(graph) == {
        "node:/a/driver", "node:/b/driver", "node:/_NODE_NAME_UNKNOWN_",
        "topic:/a/scan", "topic:/b/scan",
    }  # fmt: skip
    edges = {(u, v): (d["messages"], d["bytes"]) for u, v, d in graph.edges(data=True)}
    assert edges == {
        ("node:/a/driver", "topic:/a/scan"): (1, 100),
        ("node:/b/driver", "topic:/b/scan"): (2, 200),
        ("topic:/b/scan", "node:/_NODE_NAME_UNKNOWN_"): (0, 0),  # requests more than is offered
    }


@given(st.lists(st.floats(0.01, 8.0), max_size=20), st.floats(0.0, 9.9))
def test_every_message_is_in_the_graph_of_its_interval(
    tmp_path_factory: pytest.TempPathFactory, gaps: list[float], rest: float
) -> None:
    folder = tmp_path_factory.mktemp("graphs")
    start = 5 * SECOND_NS
    graphs = IntervalGraphs(
        lambda traffic: snapshot(Small(), traffic, fits, {"/oracle_graph_recorder"}), folder, start
    )
    now, expected = 0, Counter[int]()
    for gap in gaps:
        now += round(gap * SECOND_NS)
        graphs.pass_to(start + now)
        graphs.traffic.count("/a/scan", 10)
        expected[now // (10 * SECOND_NS)] += 1
    now += round(rest * SECOND_NS)
    graphs.finish(start + now)
    intervals = read_intervals(folder)
    edge = ("node:/a/driver", "topic:/a/scan")
    found = {number: of.graph.edges[edge]["messages"] for number, of in enumerate(intervals)}
    whole, left = divmod(now, 10 * SECOND_NS)
    assert len(found) == whole + (left >= 5 * SECOND_NS)
    assert found == {number: expected[number] for number in found}
    run = read_gexf(folder / "run.gexf")
    assert nx.utils.graphs_equal(run, compose(of.graph for of in intervals))
