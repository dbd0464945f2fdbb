"""Scenarios that change parameters of nodes, or QoS, from the onset to the end."""

import functools

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
from sim.middleware.node_parameters import EVENT
from sim.modes import find_mode
from sim.nav2.parameters import of_node
from tests.sim.fuzzing.workbench import SCAN, data, scan

SETTING = """\
schema: mutant/v1
id: setting
label: malicious
main: {{type: sensor_msgs/msg/LaserScan, input: /scan, output: /out}}
parameters:
  speed: {{type: float, default: 0.1}}
activation: {{duration_s: 4.0}}
{more}
set_parameters:
  - {{node: {node}, name: {name}, value: {value}}}
"""
OFFER = """\
schema: mutant/v1
id: offer
label: malicious
main:
  type: sensor_msgs/msg/LaserScan
  input: /scan
  output: {output}
  qos: {qos}
activation: {{duration_s: 4.0}}
"""


def setting(node="/driver", name="FollowPath.max_vel_x", value="p.speed / 2.0", more=""):
    text = SETTING.format(node=node, name=name, value=value, more=more)
    (scenario,) = parse_scenarios(text.encode(), "setting.yaml")
    return compile_scenario(scenario, allow_actuation=True)


def offer(policies="{reliability: best_effort}", output="/scan"):
    text = OFFER.format(qos=policies, output=output)
    (scenario,) = parse_scenarios(text.encode(), "offer.yaml")
    return compile_scenario(scenario)


class Bench:
    """A driver with a parameter, a reliable reader and a tolerant one; the onset is at 2 s."""

    def __init__(self, compiled):
        self.executor = Executor()
        self.domain = Domain(self.executor)
        driver = Node(self.domain, "/driver")
        self.publisher = driver.create_publisher(SCAN, "/scan")
        self.values, self.events, self.truth = [], [], []
        speed = of_node("controller_server")["FollowPath.max_vel_x"]
        driver.declare_parameter(
            "FollowPath.max_vel_x", 0.26, functools.partial(speed.checked, "max_vel_x"),
            lambda value: self.values.append((self.executor.now_ns // SECOND, value)),
        )  # fmt: skip
        self.heard = {"/reliable": [], "/tolerant": []}
        profiles = (qos.DEFAULT, qos.SENSOR_DATA)
        for (name, messages), profile in zip(self.heard.items(), profiles, strict=True):
            Node(self.domain, name).create_subscription(SCAN, "/scan", messages.append, profile)
        self.node = ScenarioNode(self.domain, "/mutant", execute(compiled, 1, {}))
        listener = Node(self.domain, "/listener")
        listener.create_subscription(GROUND_TRUTH_TYPE, GROUND_TRUTH_TOPIC, self.told)
        listener.create_subscription(EVENT, "/parameter_events", self.events.append)
        self.node.begin(2 * SECOND)

    def told(self, truth):
        if truth.operation != "passthrough":
            self.truth.append((truth.operation, truth.detail))

    def send(self):
        """Send a scan in the middle of each of ten seconds."""
        sent = [scan(n) for n in range(10)]
        for n, message in enumerate(sent):
            self.executor.call_at(n * SECOND + SECOND // 2, self.publisher.publish, message)
        self.executor.run_until(10 * SECOND)
        return sent


def test_a_parameter_is_set_from_the_onset_to_the_end_and_the_node_reports_it():
    bench = Bench(setting())
    bench.send()
    assert bench.values == [(2, 0.05), (6, 0.26)]
    told = [event.changed_parameters[0] for event in bench.events]
    assert [(each.name, each.value.double_value) for each in told] == [
        ("FollowPath.max_vel_x", 0.05),
        ("FollowPath.max_vel_x", 0.26),
    ]
    assert {event.node for event in bench.events} == {"/driver"}
    assert bench.truth == [("set_parameters", "/driver FollowPath.max_vel_x: 0.26 to 0.05")]
    assert sum(change.messages for change in bench.node.changes(0)) == 1


def test_an_attack_that_is_ended_early_sets_parameters_back_then():
    bench = Bench(setting())
    bench.node.end(4 * SECOND)
    bench.send()
    assert bench.values == [(2, 0.05), (4, 0.26)]


@pytest.mark.parametrize("control", ["shadow", "passthrough"])
def test_a_control_sets_nothing(control):
    bench = Bench(setting(more=f"control: {control}"))
    bench.send()
    assert (bench.values, bench.truth) == ([], [])


def test_switching_to_another_scenario_sets_parameters_back():
    bench = Bench(setting())
    bench.executor.run_until(3 * SECOND)
    bench.node.switch(execute(setting(value=0.2), 1, {}))
    bench.executor.run_until(10 * SECOND)
    assert bench.values == [(2, 0.05), (3, 0.26), (3, 0.2), (7, 0.26)]


@pytest.mark.parametrize(
    ("faulty", "reason"),
    [
        ({"node": "/planner"}, r"node: expected a node whose .* \(/driver\)"),
        ({"name": "max_vel"}, r"name: expected one of FollowPath.max_vel_x, found max_vel"),
        ({"value": 99}, r"value: max_vel_x: expected 0.01 to 2, found 99"),
    ],
)
def test_an_unknown_node_or_parameter_is_refused_with_its_place(faulty, reason):
    with pytest.raises(ScenarioError, match=rf"^setting.yaml:10:\d+: set_parameters\[0\].{reason}"):
        Bench(setting(**faulty))


@pytest.mark.parametrize(
    ("faulty", "reason"),
    [
        ({"value": "msg.range_max"}, "'msg' is unknown; known are p, c"),
        ({"value": "p.speed >"}, "value: "),
        ({"node": "driver"}, "node: expected a full node name"),
    ],
)
def test_a_setting_that_makes_no_sense_is_refused_when_the_file_is_read(faulty, reason):
    with pytest.raises(ScenarioError, match=r"^setting.yaml:10:\d+: ") as refused:
        setting(**faulty)
    assert reason in str(refused.value)


def test_setting_a_parameter_needs_permission():
    (scenario,) = parse_scenarios(
        SETTING.format(node="/driver", name="x", value=1, more="").encode(), "setting.yaml"
    )
    with pytest.raises(ScenarioError, match=r"^setting.yaml:10:5: .*--allow-actuation"):
        compile_scenario(scenario)


def test_a_subscriber_that_requests_more_than_is_offered_receives_nothing_until_the_end():
    bench = Bench(offer())
    sent = bench.send()
    assert bench.heard["/tolerant"] == sent
    assert bench.heard["/reliable"] == [*sent[:2], *sent[6:]]
    assert bench.truth[0] == ("offer_qos", "/scan offered as best_effort; unheard by /reliable")
    assert bench.publisher.qos == qos.DEFAULT


def test_a_compatible_offer_does_not_change_received_messages():
    bench = Bench(offer("{reliability: reliable, durability: transient_local}"))
    sent = bench.send()
    assert bench.heard == {"/reliable": sent, "/tolerant": sent}
    assert bench.node.changes(0) == ()


@pytest.mark.parametrize(
    ("faulty", "reason"),
    [
        ({"output": "/out"}, "main.qos: expected the output to be the input, /scan"),
        ({"policies": "{reliability: lossy}"}, "main.qos.reliability: expected one of reliable"),
        ({"policies": "{depth: 1}"}, "main.qos.depth: expected one of reliability, durability"),
    ],
)
def test_a_wrong_offer_is_refused_with_its_place(faulty, reason):
    with pytest.raises(ScenarioError, match=r"^offer.yaml:8:\d+: ") as refused:
        offer(**faulty)
    assert reason in str(refused.value)


@pytest.mark.parametrize("compiled", [setting(), offer()], ids=["setting", "offer"])
def test_a_bag_cannot_show_it(tmp_path, compiled):
    with BagWriter(tmp_path / "bag", "mcap") as bag:
        bag.add_topic("/scan", SCAN, [qos.DEFAULT])
        bag.write("/scan", 1, data(scan(0)))
    with pytest.raises(BagError, match="changes parameters of nodes, or QoS"):
        mutate_bag(tmp_path / "bag", tmp_path / "out", compiled, 1)


@pytest.mark.slow
def test_the_robot_drives_differently_with_other_controller_parameters(recorded_run):
    run = recorded_run(find_mode("controller_parameters", allow_actuation=True), 0)
    control = recorded_run("lidar_passthrough", 0)
    ours, theirs = run.manifest(), control.manifest()
    assert ours.topics["/parameter_events"].messages == 2
    assert theirs.topics["/parameter_events"].messages == 0
    assert ours.goal_results[0].ended_s > 1.15 * theirs.goal_results[0].ended_s
