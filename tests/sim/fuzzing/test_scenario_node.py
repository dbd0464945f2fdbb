"""The node of a scenario in a domain; that it publishes what a bag shows is in test_offline."""

import pytest

from oracle_pipeline.bags.manifest import Change
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE
from sim.fuzzing.execution import execute
from sim.fuzzing.scenario import ScenarioError
from sim.fuzzing.scenario_node import ScenarioNode
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.node import Node
from tests.sim.fuzzing.workbench import ODOMETRY, SCAN, builtin, doing, scan, scans
from tests.sim.introspection import publishers_of, subscriptions_of

LATENCY_NS = 3 * MILLISECOND


class Bench:
    """A node of a scenario, with publishers for its inputs and a record of its outputs."""

    def __init__(self, program, **parameters):
        self.executor = Executor()
        self.domain = Domain(self.executor)
        others = Node(self.domain, "/others")
        outlets = {program.input_topic: program.type.name, "/odom": ODOMETRY}
        self.publish = {t: others.create_publisher(kind, t).publish for t, kind in outlets.items()}
        self.node = ScenarioNode(
            self.domain, "/mutant", execute(program, 1, parameters), latency_ns=LATENCY_NS
        )
        self.heard, self.truth = [], []
        subscribe = others.create_subscription
        subscribe(
            program.type.name,
            program.output_topic,
            lambda message: self.heard.append((self.executor.now_ns, message)),
        )
        subscribe(GROUND_TRUTH_TYPE, GROUND_TRUTH_TOPIC, self.truth.append)

    def scans(self, messages, topic="/in", period_ns=SECOND // 5):
        for number, message in enumerate(messages):
            self.executor.call_at(number * period_ns, self.publish[topic], message)
        self.executor.run_until(len(messages) * period_ns)


def test_before_its_start_every_message_is_forwarded_after_the_latency():
    bench = Bench(doing("add: {field: ranges, by: 1.0}"))
    messages = list(scans(5))
    bench.scans(messages)
    assert [message for _, message in bench.heard] == messages
    assert [now_ns for now_ns, _ in bench.heard] == [n * SECOND // 5 + LATENCY_NS for n in range(5)]
    assert bench.node.changes(0) == ()
    assert [truth.detail for truth in bench.truth] == ["not active"] * 5


def test_messages_from_before_the_onset_are_forwarded_even_if_they_arrive_later():
    bench = Bench(doing("add: {field: ranges, by: 1.0}"))
    bench.node.begin(2 * SECOND // 5 - LATENCY_NS // 2)  # while the second scan is on its way
    bench.scans([scan(n) for n in range(4)])
    assert [message.ranges[0] for _, message in bench.heard] == [2.0, 2.0, 3.0, 3.0]


def test_changes_are_counted_in_bins_of_five_seconds_of_the_recording():
    bench = Bench(doing("drift: {field: ranges, rate: 0.1}"))
    bench.node.begin(0)
    bench.scans([scan(n) for n in range(61)])
    assert bench.node.changes(SECOND) == (
        Change(0.0, 25, pytest.approx(0.58, abs=1e-6)),
        Change(5.0, 25, pytest.approx(1.08, abs=1e-6)),
        Change(10.0, 6, pytest.approx(1.2, abs=1e-6)),
    )


def test_bins_in_which_nothing_was_changed_are_left_out_and_a_lost_range_has_no_size():
    blind = doing("set: {field: ranges, value: inf}", more="activation: {duration_s: 1.0}\n")
    bench = Bench(blind)
    bench.node.begin(6 * SECOND)
    bench.scans([scan(n) for n in range(61)])
    assert bench.node.changes(0) == (Change(5.0, 5, None),)


def test_a_shadow_and_a_passthrough_change_nothing():
    for text in ("control: shadow\n", "control: passthrough\n"):
        bench = Bench(doing("add: {field: ranges, by: 1.0}", more=text))
        bench.node.begin(0)
        bench.scans(list(scans(5)))
        assert bench.node.changes(0) == ()


def test_dropped_and_emitted_messages_are_changes():
    bench = Bench(builtin("sensor_drop"), share=1.0)
    bench.node.begin(0)
    bench.scans(list(scans(10)), "/scan_tom")
    assert bench.heard == []
    assert bench.node.changes(0) == (Change(0.0, 10, 1.0),)


def test_the_graph_shows_the_topics_of_the_scenario_and_hides_the_truth():
    domain = Bench(builtin("fake_object")).domain
    assert subscriptions_of(domain, "/mutant").keys() >= {"/scan_tom", "/odom"}
    assert "/odom" not in subscriptions_of(Bench(builtin("random_noise")).domain, "/mutant")
    published = set(publishers_of(domain, "/mutant")) - {"/rosout", "/parameter_events"}
    assert published == {"/scan_fakeobject", GROUND_TRUTH_TOPIC}


def test_a_scenario_on_a_topic_without_publisher_is_refused_with_the_existing_topics():
    domain = Domain(Executor())
    Node(domain, "/lidar").create_publisher(SCAN, "/scan")
    with pytest.raises(ScenarioError, match=r"main.input: .*LaserScan \(/scan\), found /scan_tom"):
        ScenarioNode(domain, "/mutant", execute(builtin("random_noise"), 1))


def test_a_scenario_cannot_publish_on_a_topic_of_another_type():
    domain = Domain(Executor())
    Node(domain, "/lidar").create_publisher(SCAN, "/scan_tom")
    Node(domain, "/other").create_publisher(ODOMETRY, "/scan_fakeobject")
    with pytest.raises(ScenarioError, match=r"main.output: expected a topic that is no nav_msgs"):
        ScenarioNode(domain, "/mutant", execute(builtin("random_noise"), 1))
