"""Scenarios on the links to some nodes: only these receive altered, late or no messages."""

import pytest

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE
from oracle_pipeline.bags.writer import BagWriter
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.offline import mutate_bag
from sim.fuzzing.scenario import ScenarioError, parse_scenarios
from sim.fuzzing.scenario_node import ScenarioNode
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.middleware.node import Node
from tests.sim.fuzzing.workbench import SCAN, data, scan

LINK = """\
schema: mutant/v1
id: link
label: malicious
main: {{type: sensor_msgs/msg/LaserScan, input: /scan, output: {output}, to: [{to}]}}
transform:
  actions:
    - {{name: altered, do: [{do}]}}
"""


def program(do="drop: {}", to="/reader", output="/scan"):
    text = LINK.format(do=f"{{{do}}}", to=to, output=output)
    (scenario,) = parse_scenarios(text.encode(), "link.yaml")
    return compile_scenario(scenario)


class Bench:
    """A driver, a reader whose link is attacked, and another one."""

    def __init__(self, compiled):
        self.executor = Executor()
        self.domain = Domain(self.executor)
        self.driver = Node(self.domain, "/driver").create_publisher(SCAN, "/scan")
        self.heard = {"/reader": [], "/other": []}
        self.truth = []
        for name, messages in self.heard.items():
            Node(self.domain, name).create_subscription(SCAN, "/scan", messages.append)
        self.graph = self.domain.node_names()
        self.node = ScenarioNode(self.domain, "/mutant", execute(compiled, 1, {}))
        self.node.begin(0)
        Node(self.domain, "/truth").create_subscription(
            GROUND_TRUTH_TYPE, GROUND_TRUTH_TOPIC, self.truth.append
        )

    def send(self, count):
        sent = [scan(n) for n in range(count)]
        for n, message in enumerate(sent):
            self.executor.call_at(n * SECOND // 5, self.driver.publish, message)
        self.executor.run_until(60 * SECOND)
        return sent


def test_samples_are_lost_on_one_link_and_on_no_other():
    bench = Bench(program())
    sent = bench.send(5)
    assert bench.heard == {"/reader": [], "/other": sent}
    assert [truth.operation for truth in bench.truth] == ["altered"] * 5
    assert sum(change.messages for change in bench.node.changes(0)) == 5


def test_samples_overtake_each_other_and_keep_their_stamps():
    bench = Bench(program('delay: {seconds: "uniform(0.0, 2.0)"}'))
    sent = bench.send(20)
    assert bench.heard["/other"] == sent
    heard = bench.heard["/reader"]
    assert sorted(map(sent.index, heard)) == list(range(20))
    assert list(map(sent.index, heard)) != list(range(20))


def test_a_man_in_the_middle_of_one_link_alters_the_messages_for_one_node():
    bench = Bench(program("scale: {field: ranges, by: 0.5}"))
    sent = bench.send(3)
    assert list(map(data, bench.heard["/other"])) == list(map(data, sent))
    for altered, message in zip(bench.heard["/reader"], sent, strict=True):
        assert altered.ranges.tolist() == (message.ranges * 0.5).tolist()


def test_the_graph_does_not_show_it():
    bench = Bench(program())
    assert bench.domain.node_names() == sorted([*bench.graph, "/truth"])
    assert [p.node for p in bench.domain.publishers("/scan")] == ["/driver"]


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"output": "/scan_fuzzed"}, "main.to: expected the output to be the input, /scan"),
        ({"to": "reader"}, "expected a full node name such as /controller_server"),
        ({"to": "/reader, /reader"}, "expected each value once"),
    ],
)
def test_a_wrong_link_is_refused_with_its_place(more, reason):
    with pytest.raises(ScenarioError, match=r"^link.yaml:4:\d+: main.to") as refused:
        program(**more)
    assert reason in str(refused.value)


def test_a_node_that_does_not_subscribe_to_the_topic_is_refused_with_those_that_do():
    with pytest.raises(
        ScenarioError, match=r"subscribes to /scan \(/other, /reader\), found /planner"
    ):
        Bench(program(to="/planner"))


def test_a_bag_cannot_show_what_happens_on_a_link(tmp_path):
    with BagWriter(tmp_path / "bag", "mcap") as bag:
        bag.add_topic("/scan", SCAN, [qos.DEFAULT])
        bag.write("/scan", 1, data(scan(0)))
    with pytest.raises(BagError, match="A bag shows what the recorder receives"):
        mutate_bag(tmp_path / "bag", tmp_path / "out", program(), 1)
