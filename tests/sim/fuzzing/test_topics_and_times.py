"""Topics of a scenario, its onset and end, and the values that each run draws."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.bags.manifest import Change
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from oracle_pipeline.bags.writer import BagWriter
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.offline import mutate_bag
from sim.fuzzing.random import drawn_values
from sim.fuzzing.scenario import ScenarioError, parse_scenarios
from sim.fuzzing.scenario_node import ScenarioNode
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.middleware.node import Node
from sim.middleware.stamps import header
from sim.recording import Recorder
from tests.sim.fuzzing.workbench import (
    ODOMETRY,
    SCAN,
    odometry,
    program,
    results,
    scan,
    scans,
    scenario,
    stamp,
)
from tests.sim.introspection import publishers_of

BEGIN_NS, ONSET_S = SECOND, 2.1
ODD = (
    "transform: {actions: [{name: odd, "
    "do: [{noise: {field: ranges, dist: gauss, absolute: 0.1}}]}]}"
)


def in_place(rest):
    text = (
        "schema: mutant/v1\nid: tried\nlabel: malicious\n"
        f"main: {{type: {SCAN}, input: /scan, output: /scan}}\n{rest}"
    )
    (parsed,) = parse_scenarios(text.encode(), "tried.yaml")
    return compile_scenario(parsed)


def record(compiled, path, onset_s=ONSET_S):
    """Record scans, and a scenario at work on them if there is one; return the domain and node."""
    executor = Executor()
    domain = Domain(executor)
    publisher = Node(domain, "/lidar").create_publisher(SCAN, "/scan")
    node = None
    executor.run_until(BEGIN_NS)
    with BagWriter(path, "mcap") as writer:
        if compiled is not None:
            node = ScenarioNode(domain, "/mutant", execute(compiled, 1), latency_ns=3_000_000)
            node.begin(BEGIN_NS + round(onset_s * SECOND))
        Recorder(domain, writer)
        for number, message in enumerate(scans(40)):
            executor.call_at(BEGIN_NS + number * 200_000_000, publisher.publish, message)
        executor.run_until(BEGIN_NS + 9 * SECOND)
    return domain, node


def on(path, topic):
    with BagReader(path) as bag:
        return [(m.stamp_ns, m.data) for m in bag.messages([topic])]


@pytest.mark.parametrize("more", [
    ODD,
    "transform: {actions: [{name: lost, when: bernoulli(0.3), do: [{drop: {}}]}]}",
    "transform: {actions: [{name: late, do: [{delay: {seconds: 0.5}}]}]}",
    "transform: {timer: {period_s: 0.517, do: [{emit: {fields: {range_max: 1.0}}}]}}",
    "activation: {messages: 7}\n" + ODD,
])  # fmt: skip
def test_in_place_all_subscribers_receive_the_altered_topic_and_no_node_is_added(more, tmp_path):
    compiled = in_place(more)
    domain, node = record(compiled, tmp_path / "altered")
    plain, _ = record(None, tmp_path / "plain")
    assert domain.node_names() == plain.node_names()
    assert {p.topic for p in domain.publishers()} - {GROUND_TRUTH_TOPIC} == {
        p.topic for p in plain.publishers()
    }
    mutate_bag(tmp_path / "plain", tmp_path / "mutant", compiled, 1, at_s=ONSET_S)
    altered, mutant = (on(tmp_path / bag, "/scan") for bag in ("altered", "mutant"))
    assert altered[: len(mutant)] == mutant  # what is due after the end is not in the mutant
    assert len(mutant) > 20
    assert mutant != on(tmp_path / "plain", "/scan")
    assert sum(change.messages for change in node.changes(BEGIN_NS)) > 0


def test_in_place_a_message_that_stays_keeps_its_bytes_and_its_time(tmp_path):
    compiled = in_place("control: passthrough\n" + ODD)
    record(compiled, tmp_path / "altered")
    record(None, tmp_path / "plain")
    assert on(tmp_path / "altered", "/scan") == on(tmp_path / "plain", "/scan")
    absent = in_place("activation: {before: absent}\n" + ODD)
    mutate_bag(tmp_path / "plain", tmp_path / "mutant", absent, 1, at_s=ONSET_S)
    before = [data for at, data in on(tmp_path / "plain", "/scan") if at < BEGIN_NS + 2.1 * SECOND]
    assert [data for _, data in on(tmp_path / "mutant", "/scan")][: len(before)] == before
    assert len(on(tmp_path / "mutant", "/scan")) == 40


def test_messages_are_emitted_on_other_topics_of_other_types(tmp_path):
    compiled = in_place("""\
outputs:
  alarm: {type: std_msgs/msg/String, topic: /alarm}
  ghost: {type: nav_msgs/msg/Odometry, topic: /ghost}
transform:
  actions:
    - name: told
      do:
        - emit: {to: alarm, fields: {data: "'near'"}}
        - emit: {to: ghost, fields: {pose.pose.position.x: "msg.ranges[0]"}}
""")
    domain, _ = record(compiled, tmp_path / "online")
    record(None, tmp_path / "plain")
    mutate_bag(tmp_path / "plain", tmp_path / "offline", compiled, 1, at_s=ONSET_S)
    for topic in ("/alarm", "/ghost"):
        told = on(tmp_path / "online", topic)
        assert told == on(tmp_path / "offline", topic)
        assert len(told) == 29
    assert publishers_of(domain, "/lidar").keys() >= {"/alarm", "/ghost"}
    with BagReader(tmp_path / "online") as bag:
        first = bag.deserialize(next(bag.messages(["/ghost"])))
    assert (first.header.stamp.sec, first.header.frame_id) == (2, "base_scan_tom")


@pytest.mark.parametrize(
    ("rest", "expected"),
    [
        ("transform: {always: [{emit: {to: gone, fields: {}}}]}", r"emit.to: expected one of"),
        ("outputs: {a: {type: std_msgs/msg/String, topic: /in}}", r"a.topic: .*not subscribe"),
        ("outputs: {a: {type: std_msgs/msg/String, topic: /out}}", r"outputs.a.topic: .*another"),
        ("outputs: {a: {type: geometry_msgs/msg/Twist, topic: /b}}", r"outputs.a.topic: .*moves"),
        ("outputs: {a: {type: std_msgs/msg/Strin, topic: /b}}", r"outputs.a.type: "),
        ("outputs: {a: {type: std_msgs/msg/String, topic: /_oracle/ground_truth}}", "no use of"),
        (
            "outputs: {a: {type: std_msgs/msg/String, topic: /b}}\n"
            "transform: {always: [{emit: {to: a, copy: msg, fields: {}}}]}",
            r"emit.copy: expected no copy: a is of another type",
        ),
        ("activation: {onset: {goal: 2}}", r"onset.goal: expected after: goal_accepted"),
        (
            "activation: {onset: {after: goal_accepted, goal: 2}, until_goal: 2}",
            r"until_goal: expected a goal after the one at which it begins, 2, found 2",
        ),
        ("parameters: {a: {type: bool, default: true, draw: even}}", r"a.draw: expected a number"),
        ("parameters: {a: {type: int, default: 1, draw: even}}", r"a.draw: expected a min"),
        ("parameters: {a: {type: float, default: 1, min: 0, max: 2, draw: log}}", r"min above 0"),
        (
            "parameters: {a: {type: int, default: 1, min: 0.2, max: 0.8, draw: even}}",
            r"a.draw: expected a whole number",
        ),
    ],
)  # fmt: skip
def test_impossible_values_are_refused_with_their_place(rest, expected):
    with pytest.raises(ScenarioError, match=rf"tried\.yaml:\d+:\d+: .*{expected}"):
        program(rest)


def touched(compiled, count=30):
    return [n for n, result in enumerate(results(compiled, list(scans(count))))
            if result.truth.operation != "passthrough"]  # fmt: skip


def test_a_scenario_ends_after_so_many_messages_a_duration_or_at_a_goal():
    assert touched(program("activation: {messages: 5}\n" + ODD)) == [0, 1, 2, 3, 4]
    assert touched(program("activation: {duration_s: 0.9}\n" + ODD)) == [0, 1, 2, 3, 4]
    spared = touched(program("activation: {messages: 5, probability: 0.5}\n" + ODD))
    assert len(spared) == 5
    assert spared != [0, 1, 2, 3, 4]
    execution = execute(program("activation: {until_goal: 2}\n" + ODD), 1)
    execution.end(0.9)
    acted = [execution.on_message(scan(n), stamp(n), 0.2 * n).truth for n in range(8)]
    assert [truth.operation for truth in acted] == ["odd"] * 5 + ["passthrough"] * 3


def test_ticks_of_a_timer_count_as_messages(tmp_path):
    compiled = in_place(
        "activation: {messages: 3}\n"
        "transform: {timer: {period_s: 1.0, do: [{emit: {fields: {range_max: 1.0}}}]}}"
    )
    record(compiled, tmp_path / "bag", onset_s=0.0)
    told = on(tmp_path / "bag", "/scan")
    assert 0 < len(told) - 40 <= 3


@given(
    st.integers(0, 2**64 - 1), st.floats(0.001, 5.0), st.floats(1.0, 20.0),
    st.sampled_from(["even", "log"]), st.sampled_from(["float", "int"]),
)  # fmt: skip
@settings(max_examples=50)
def test_a_drawn_parameter_is_a_function_of_the_run_and_within_its_bounds(
    seed, low, ratio, how, kind
):
    high = max(low * ratio, low + 1.0)
    low, high = (float(f"{bound:.6f}") for bound in (low, high))
    compiled = program(
        f"parameters: {{a: {{type: {kind}, default: {int(high)}, min: {low}, max: {high}, "
        f"draw: {how}}}}}"
    )
    values = drawn_values(compiled.scenario, seed)
    assert values == drawn_values(compiled.scenario.as_shadow(), seed)
    assert low <= values["a"] <= high
    assert type(values["a"]) is {"float": float, "int": int}[kind]


def test_draws_have_their_distribution_and_a_given_value_has_precedence():
    def drawn(how, kind, low, high):
        text = (
            f"parameters: {{a: {{type: {kind}, default: {low}, min: {low}, max: {high}, "
            f"draw: {how}}}}}"
        )
        return [drawn_values(scenario(text), seed)["a"] for seed in range(400)]

    assert np.median(drawn("even", "float", 1.0, 101.0)) == pytest.approx(51.0, abs=8.0)
    assert np.median(drawn("log", "float", 0.01, 1.0)) == pytest.approx(0.1, rel=0.4)
    assert set(drawn("even", "int", 1, 4)) == {1, 2, 3, 4}
    text = (
        "parameters: {a: {type: float, default: 1.0, min: 0.0, max: 9.0, draw: even}}\n"
        "transform: {actions: [{name: set, do: [{set: {field: range_max, value: p.a}}]}]}"
    )
    (given,) = results(program(text), [scan()], a=2.5)
    assert given.outputs[0].message.range_max == 2.5
    (one,), (other,) = (results(program(text), [scan()], seed=seed) for seed in (1, 2))
    assert one.outputs[0].message.range_max != other.outputs[0].message.range_max


def test_in_place_without_a_publisher_is_refused():
    domain = Domain(Executor())
    node = Node(domain, "/reader")
    node.create_subscription(SCAN, "/scan", None)
    with pytest.raises(ScenarioError, match="main.output: expected a topic with a publisher"):
        ScenarioNode(domain, "/mutant", execute(in_place(ODD), 1))


def test_an_end_that_comes_before_the_onset_leaves_all_as_it_is(tmp_path):
    executor = Executor()
    domain = Domain(executor)
    publisher = Node(domain, "/lidar").create_publisher(SCAN, "/scan")
    node = ScenarioNode(domain, "/mutant", execute(in_place(ODD), 1))
    node.end(0)
    node.begin(0)
    for number, message in enumerate(scans(5)):
        executor.call_at(number, publisher.publish, message)
    executor.run_until(10)
    assert node.changes(0) == tuple[Change, ...]()


TOGETHER = f"""\
schema: mutant/v1
id: tried
label: malicious
main: {{type: {SCAN}, input: /scan, output: /scan_a}}
also:
  tom: {{type: {SCAN}, input: /scan_tom, output: /tom_a}}
  odom: {{type: nav_msgs/msg/Odometry, input: /odom, output: /odom_a}}
parameters: {{by: {{type: float, default: 1.0, min: 0.5, max: 2.0, draw: even}}}}
transform:
  match: all
  actions:
    - name: nearer
      on: [main, tom]
      do:
        - set: {{field: range_max, value: "uniform(0.0, 1.0)"}}
    - name: ahead
      on: [odom]
      do:
        - add: {{field: pose.pose.position.x, by: p.by}}
"""


def together(text=TOGETHER):
    (parsed,) = parse_scenarios(text.encode(), "tried.yaml")
    return compile_scenario(parsed)


def record_three(compiled, path):
    """Record two LiDARs, one 60 ms behind the other, and odometry, altered together."""
    executor = Executor()
    domain = Domain(executor)
    driver = Node(domain, "/drivers")
    speak = {
        topic: driver.create_publisher(kind, topic).publish
        for topic, kind in (("/scan", SCAN), ("/scan_tom", SCAN), ("/odom", ODOMETRY))
    }
    executor.run_until(BEGIN_NS)
    with BagWriter(path, "mcap") as writer:
        node = ScenarioNode(domain, "/mutant", execute(compiled, 1), latency_ns=3_000_000)
        node.begin(BEGIN_NS + round(ONSET_S * SECOND))
        Recorder(domain, writer)
        for number, message in enumerate(scans(30)):
            at_ns = BEGIN_NS + number * 200_000_000
            later = replace(message, header=header(stamp(number) + 60_000_000, "tom"))
            executor.call_at(at_ns, speak["/scan"], message)
            executor.call_at(at_ns + 20_000_000, speak["/odom"], odometry(number))
            executor.call_at(at_ns + 60_000_000, speak["/scan_tom"], later)
        executor.run_until(BEGIN_NS + 7 * SECOND)
    return domain


def test_topics_are_altered_together_with_the_draws_of_the_main_message_before(tmp_path):
    compiled = together()
    domain = record_three(compiled, tmp_path / "bag")
    mutate_bag(tmp_path / "bag", tmp_path / "mutant", compiled, 1, at_s=ONSET_S)
    for topic in ("/scan_a", "/tom_a", "/odom_a"):
        online = [data for _, data in on(tmp_path / "bag", topic)]
        assert online == [data for _, data in on(tmp_path / "mutant", topic)]
        assert len(online) == 30
    drawn = {}
    with BagReader(tmp_path / "bag") as bag:
        for topic in ("/scan_a", "/tom_a"):
            read = [bag.deserialize(raw).range_max for raw in bag.messages([topic])]
            drawn[topic] = read[11:]  # 2.1 s are between the tenth and the eleventh
        moved = [bag.deserialize(raw).pose.pose.position.x for raw in bag.messages(["/odom_a"])]
    assert drawn["/scan_a"] == drawn["/tom_a"]
    assert len(set(drawn["/scan_a"])) == 19
    by = drawn_values(compiled.scenario, 1)["by"]
    assert moved == [0.0] * 11 + [pytest.approx(by)] * 19
    assert publishers_of(domain, "/mutant").keys() >= {"/scan_a", "/tom_a", "/odom_a"}


def test_too_far_behind_a_message_has_independent_draws(tmp_path):
    near = TOGETHER.replace("output: /tom_a}", "output: /tom_a, within_s: 0.05}")
    record_three(together(near), tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag:
        one, other = (
            [bag.deserialize(raw).range_max for raw in bag.messages([topic])][11:]
            for topic in ("/scan_a", "/tom_a")
        )
    assert set(one).isdisjoint(other)


def test_several_topics_can_be_altered_in_place(tmp_path):
    text = TOGETHER.replace("/scan_a", "/scan").replace("/tom_a", "/scan_tom")
    text = text.replace("/odom_a", "/odom")
    domain = record_three(together(text), tmp_path / "altered")
    assert "/mutant" not in domain.node_names()
    still = together(text.replace("label: malicious", "label: malicious\ncontrol: passthrough"))
    record_three(still, tmp_path / "plain")
    mutate_bag(tmp_path / "plain", tmp_path / "mutant", together(text), 1, at_s=ONSET_S)
    for topic in ("/scan", "/scan_tom", "/odom"):
        assert on(tmp_path / "altered", topic) == on(tmp_path / "mutant", topic)
        assert on(tmp_path / "altered", topic) != on(tmp_path / "plain", topic)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("input: /scan_tom", "input: /scan", "also.tom.input: expected a different topic"),
        ("/odom_a", "/odom", "also.odom.output: expected all topics to be altered in place"),
        (
            "/odom_a",
            "/scan",
            "also.odom.output: expected a topic to which the scenario does not subscribe",
        ),
        ("/tom_a", "/scan_a", "also.tom.output: expected another topic: /scan_a is named"),
        ("  tom:", "  main:", "also.main: expected another name"),
        ("[main, tom]", "[main, ella]", r"actions\[0\].on\[1\]: expected one of main, tom, odom"),
        ("[main, tom]", "[main, odom]", r"actions\[0\].do\[0\].set.field: "),
        ("nav_msgs/msg/Odometry", "nav_msgs/msg/Odometer", "also.odom.type: "),
    ],
)
def test_topics_that_cannot_be_altered_together_are_refused_where_they_stand(old, new, expected):
    with pytest.raises(ScenarioError, match=rf"tried\.yaml:\d+:\d+: .*{expected}"):
        together(TOGETHER.replace(old, new))


def test_all_faults_of_topics_are_reported_at_once():
    text = TOGETHER.replace("/odom_a", "/odom").replace("[main, tom]", "[main, ella]")
    with pytest.raises(ScenarioError) as caught:
        together(text)
    told = str(caught.value)
    assert "also.odom.output" in told
    assert "transform.actions[0].on[1]" in told
