"""The graph of a run against the graph of the real system: `tests.sim.humble` and the
differences that docs/explanation/testbed.md states, nothing else."""

import re
from collections import Counter

import pytest
from rosbags.interfaces import QosTime

from oracle_pipeline.bags.graph_files import read_gexf, vertex_id
from oracle_pipeline.bags.protocol import is_hidden
from oracle_pipeline.bags.qos_profiles import is_latched, is_reliable
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE
from oracle_pipeline.bags.writer import BagWriter
from sim.campaigns import Campaign
from tests.sim import humble
from tests.sim.introspection import (
    action_clients_of,
    action_servers_of,
    clients_of,
    publishers_of,
    services_of,
)
from tests.sim.system import ADDED_NODES, LESS, MORE, NODES, RUN, System

ENDS = ("publishes", "subscribes")
DEFAULT_LIFESPAN = QosTime(9223372036, 854775807)

ADDED_TYPES = {
    "/scan_tom": "sensor_msgs/msg/LaserScan",
    "/scan_fakeobject": "sensor_msgs/msg/LaserScan",
    "/range_ella": "sensor_msgs/msg/Range",
    "/polygon_slowdown": "geometry_msgs/msg/PolygonStamped",
}
TYPES = humble.TYPES | ADDED_TYPES


def expected_endpoints(node):
    """Return {(end, topic): QoS} of a node: the real one's and the documented ones."""
    expected = humble.endpoints(node) if node in humble.NODES else {("publishes", "/rosout"): "TL"}
    if node in MORE:
        codes, *columns, _ = MORE[node]
        expected |= humble.implicit_endpoints(codes)
        expected |= {(e, t): "" for e, topics in zip(ENDS, columns, strict=True) for t in topics}
    return expected


@pytest.fixture(scope="module")
def domain(tmp_path_factory):
    """The graph of a run, complete."""
    system = System()
    system.activate()
    with BagWriter(tmp_path_factory.mktemp("bag") / "bag") as bag:
        system.complete(bag)
        system.run(0.5)
        yield system.domain


def named(domain, node):
    """Return the nodes that go by a plain name."""
    return [name for name in domain.node_names() if humble.plain(name) == node]


def endpoints_of(domain, node):
    """Yield (end, endpoint) of a node, hidden ones left out."""
    for end, endpoints in zip(ENDS, (domain.publishers(), domain.subscriptions()), strict=True):
        yield from ((end, e) for e in endpoints if e.node == node and not is_hidden(e.topic))


def test_the_list_of_the_real_graph_has_the_published_numbers_of_vertices_and_edges():
    edges = {(node, *key) for node in humble.NODES for key in humble.endpoints(node)}
    published = {topic for _, end, topic in edges if end == "publishes"}
    edges |= {(humble.RECORDER, "subscribes", topic) for topic in published}
    listeners = [edge for edge in edges if edge[0] == humble.LISTENER]
    more = humble.LISTENERS - 1
    assert set(humble.TYPES) - published == humble.NEVER_PUBLISHED
    assert (
        len(humble.NODES) + more + len(humble.TYPES),
        len(edges) + more * len(listeners),
    ) == humble.COUNTS
    hidden = 2 * len(humble.ACTIONS)
    ends = sum(1 + len(clients) for _, _, clients in humble.ACTIONS.values())
    assert (
        humble.COUNTS[0] + hidden,
        humble.COUNTS[1] + 2 * (ends + len(humble.RVIZ_SHOWS)),
    ) == humble.COUNTS_WITH_HIDDEN


def test_nodes_are_those_of_the_real_system_and_the_documented_ones(domain):
    expected = Counter(NODES) + Counter({humble.LISTENER: humble.LISTENERS - 1})
    assert Counter(map(humble.plain, domain.node_names())) == expected


def test_topics_and_types_are_those_of_the_real_system_and_the_documented_ones(domain):
    assert {t: kind for t, kind in domain.topics.items() if not is_hidden(t)} == TYPES


@pytest.mark.parametrize("node", MORE)
def test_a_documented_difference_exists_and_has_a_reason(node):
    codes, publishes, subscribes, why = MORE[node]
    real = humble.endpoints(node) if node in humble.NODES else {}
    assert not {("publishes", topic) for topic in publishes} & real.keys()
    assert not {("subscribes", topic) for topic in subscribes} & real.keys()
    assert bool(codes) == (node in ADDED_NODES)
    assert why


@pytest.mark.parametrize("node", [node for node in NODES if node != humble.RECORDER])
def test_a_node_has_the_topics_and_qos_of_the_real_one(domain, node):
    expected = expected_endpoints(node)
    for name in named(domain, node):
        live = list(endpoints_of(domain, name))
        counts = Counter((end, endpoint.topic) for end, endpoint in live)
        assert counts == {key: humble.SEVERAL.get((node, *key), 1) for key in expected}
        for end, endpoint in live:
            wanted = expected[end, endpoint.topic]
            assert fits(endpoint.qos, wanted, end), f"{end} {endpoint.topic}, {wanted}"


def fits(qos, wanted, end):
    """Return whether a profile is that of its code."""
    if not wanted:
        return True
    policy, depth = re.fullmatch(r"(SYS|TL|BE|K)(\d*)", wanted).groups()
    reliable = end == "publishes" if policy == "SYS" else policy != "BE"
    return (
        is_reliable(qos) == reliable
        and is_latched(qos) == (policy == "TL")
        and (not depth or qos.depth == int(depth))
    )


def test_only_the_log_expires(domain):
    for publisher in domain.publishers():
        expires = publisher.topic == "/rosout"
        assert publisher.qos.lifespan == (QosTime(10, 0) if expires else DEFAULT_LIFESPAN)


def test_the_recorder_receives_every_visible_topic_with_the_offered_qos(domain):
    offered = {}
    for publisher in domain.publishers():
        offered.setdefault(publisher.topic, []).append(publisher.qos)
    heard = {s.topic: s.qos for s in domain.subscriptions() if s.node == humble.RECORDER}
    assert heard.pop(GROUND_TRUTH_TOPIC)
    ((node, (left_out, why)),) = LESS.items()
    assert node == humble.RECORDER
    assert why
    assert {topic for topic in offered if not is_hidden(topic)} == {*heard, *left_out}
    assert not heard.keys() & set(left_out)
    assert TYPES.keys() - offered.keys() == humble.NEVER_PUBLISHED
    del heard["/parameter_events"]  # that is its node's own
    for topic, qos in heard.items():
        assert is_reliable(qos) == all(map(is_reliable, offered[topic]))
        assert is_latched(qos) == all(map(is_latched, offered[topic]))
        assert qos.depth == 10
    assert set(publishers_of(domain, humble.RECORDER)) == {"/rosout", "/events/write_split"}


@pytest.mark.parametrize("node", NODES)
def test_a_node_offers_and_calls_the_services_of_the_real_one(domain, node):
    codes = humble.NODES[node][0] if node in humble.NODES else MORE[node][0]
    for name in named(domain, node):
        expected = dict(humble.SERVICES.get(node, {}))
        if "P" in codes:
            expected |= {f"{name}/{s}": kind for s, kind in humble.PARAMETER_SERVICES.items()}
        if "L" in codes:
            expected |= {f"{name}/{s}": kind for s, kind in humble.LIFECYCLE_SERVICES.items()}
        offered = services_of(domain, name).items()
        assert {s: kind for s, kind in offered if not is_hidden(s)} == expected
        assert clients_of(domain, name) == humble.SERVICE_CLIENTS.get(node, {})


@pytest.mark.parametrize("action", humble.ACTIONS)
def test_an_action_has_the_server_the_clients_and_the_hidden_names_of_the_real_one(domain, action):
    name, server, clients = humble.ACTIONS[action]
    kind = f"nav2_msgs/action/{name}"
    nodes = domain.node_names()
    assert {n: action_servers_of(domain, n)[action] for n in nodes
            if action in action_servers_of(domain, n)} == {server: kind}  # fmt: skip
    assert {n: action_clients_of(domain, n)[action] for n in nodes
            if action in action_clients_of(domain, n)} == dict.fromkeys(clients, kind)  # fmt: skip
    assert {
        s: t for s, t in services_of(domain, server).items() if s.startswith(f"{action}/_action/")
    } == {
        f"{action}/_action/send_goal": f"{kind}_SendGoal",
        f"{action}/_action/get_result": f"{kind}_GetResult",
        f"{action}/_action/cancel_goal": "action_msgs/srv/CancelGoal",
    }
    listeners = clients | ({"/rviz"} if action in humble.RVIZ_SHOWS else set())
    for topic, msgtype, qos in (
        (f"{action}/_action/feedback", f"{kind}_FeedbackMessage", "K10"),
        (f"{action}/_action/status", "action_msgs/msg/GoalStatusArray", "TL1"),
    ):
        assert domain.topics[topic] == msgtype
        (publisher,) = domain.publishers(topic)
        assert publisher.node == server
        assert fits(publisher.qos, qos, "publishes")
        assert {s.node for s in domain.subscriptions(topic)} == listeners


def test_actions_are_those_of_the_real_system(domain):
    served = [action for n in domain.node_names() for action in action_servers_of(domain, n)]
    assert Counter(served) == dict.fromkeys(humble.ACTIONS, 1)


def test_beyond_the_actions_only_the_ground_truth_is_hidden(domain):
    hidden = {topic for topic in domain.topics if is_hidden(topic)}
    rest = {topic for topic in hidden if "/_action/" not in topic}
    assert {topic: domain.topics[topic] for topic in rest} == {
        GROUND_TRUTH_TOPIC: GROUND_TRUTH_TYPE
    }
    assert len(hidden - rest) == 2 * len(humble.ACTIONS)


def test_names_that_stand_for_processes_come_from_the_run_alone(domain):
    again, other = (set(System(run).domain.node_names()) for run in (RUN, RUN + 1))
    assert again <= set(domain.node_names())
    assert {humble.plain(name) for name in again - other} == {
        humble.LISTENER, "/launch_ros_PID"
    }  # fmt: skip
    assert len(again - other) == humble.LISTENERS + 1


@pytest.mark.slow
def test_the_graph_that_a_run_records_is_this_one(domain, recorded_run):
    directory = recorded_run("lidar_passthrough_odom", RUN, Campaign(goals_per_run=1, timeout_s=15))
    graph = read_gexf(directory.graphs / "run.gexf")
    vertices = {(vertex_id("node", name), "") for name in domain.node_names()}
    vertices |= {(vertex_id("topic", topic), kind) for topic, kind in TYPES.items()}
    assert {(vertex, data["type"]) for vertex, data in graph.nodes(data=True)} == vertices
    edges = set()
    for name in domain.node_names():
        for end, endpoint in endpoints_of(domain, name):
            ends = (vertex_id("node", name), vertex_id("topic", endpoint.topic))
            edges.add(ends if end == "publishes" else ends[::-1])
    assert set(graph.edges) == edges
