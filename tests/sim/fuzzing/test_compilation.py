"""A scenario with wrong types, without permission or with too much computation is refused."""

import math
import re

import pytest

from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.scenario import ScenarioError
from tests.sim.fuzzing.workbench import SCAN, builtin, doing, program, scenario


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"level": 1.5}, r"parameters\.level: expected 0\.0 to 1\.0, found 1\.5"),
        ({"level": math.nan}, "expected 0.0 to 1.0, found nan"),
        ({"level": "much"}, "expected a number, found 'much'"),
        ({"level": True}, "expected a number, found True"),
        ({"volume": 1.0}, "expected one of level, found volume"),
    ],
)
def test_a_run_cannot_have_parameters_that_the_scenario_does_not_allow(parameters, expected):
    with pytest.raises(ScenarioError, match=expected):
        execute(builtin("random_noise"), 1, parameters)


ACT = "transform: {{actions: [{{name: act, do: [{}]}}]}}\n"


@pytest.mark.parametrize(
    ("rest", "where", "expected"),
    [
        (ACT.format("{set: {field: rangs, value: 1}}"), "field", "expected a field of sensor_msgs"),
        (ACT.format("{set: {field: ranges, value: msg.rangs}}"), "value", "no field 'rangs'"),
        (ACT.format("{set: {field: angle_min, value: '\"a\"'}}"), "value", "found a text"),
        (ACT.format("{set: {field: header, value: 1}}"), "value", "expected a std_msgs/msg/Header"),
        (ACT.format("{add: {field: header, by: 1}}"), "field", "expected a number or an array"),
        (ACT.format("{map_array: {field: angle_min, as: [r], value: r}}"), "field", "an array of"),
        (ACT.format("{map_array: {field: ranges, as: [p], value: 1}}"), "as", "taken"),
        (ACT.format("{for_each: {field: ranges, as: [r], do: []}}"), "field", "array of messages"),
        (ACT.format("{remove_where: {field: angle_min, as: [r], where: true}}"), "field", "array"),
        (ACT.format("{noise: {field: ranges, dist: gauss, clip: [0, 1]}}"), "noise", "one of"),
        (ACT.format("{store: {into: x, value: 1}}"), "into", "name under state, found x"),
        (ACT.format("{emit: {fields: {nothing: 1}}}"), "fields.nothing", "expected a field of"),
        (ACT.format("{delay: {seconds: 'true'}}"), "seconds", "expected a number"),
        (ACT.format("{drop: {}}, {set: {field: angle_min, value: 1}}, "
                    "{add: {field: angle_min, by: 1}}"), "do[2].add.field", "no operator above"),
        ("transform: {timer: {period_s: 1, do: [{drop: {}}]}}\n", "drop", "one of emit, store"),
        ("transform: {timer: {period_s: 1, do: [{emit: {copy: msg, fields: {}}}]}}\n", "copy", "a"),
        ("transform: {timer: {period_s: 1, do: [{emit: {fields: {angle_min: msg.angle_max}}}]}}\n",
         "angle_min", "'msg' is unknown"),
        ("transform: {actions: [{name: a, when: 1, do: []}]}\n", "when", "expected a boolean"),
        ("functions: {f: {params: [], expr: fn.f()}}\n", "functions", "cannot call themselves"),
        ("functions: {f: {params: [msg], expr: 1 +}}\n", "functions.f", "expected"),
        ("sources: {s: {type: nav_msgs/msg/Nothing, topic: /s}}\n", "sources.s.type", "unknown"),
        ("parameters: {a: {type: int, default: 1.5}}\n", "parameters.a.default", "a whole number"),
        ("parameters: {a: {type: float, default: 2, max: 1}}\n", "parameters.a.default", "to 1"),
        ("state: {a: {type: bool, default: 1}}\n", "state.a.default", "true or false"),
        ("constants: {a: [1, [2, 3]]}\n", "constants.a", "all numbers or all pairs"),
    ],
    ids=lambda value: value[:60],
)  # fmt: skip
def test_a_value_of_the_wrong_type_is_refused_with_its_place(rest, where, expected):
    with pytest.raises(ScenarioError) as refused:
        program(rest)
    text = str(refused.value)
    place, key, reason = text.split(": ", 2)
    assert re.fullmatch(r"tried.yaml:5:[0-9]+", place)
    assert key.endswith(where)
    assert expected in reason


def faults(rest, msgtype=SCAN):
    """The places of all faults, in the order in which they are reported."""
    with pytest.raises(ScenarioError) as refused:
        program(rest, msgtype)
    return [line.split(": ")[1] for line in str(refused.value).splitlines()]


def test_all_independent_faults_are_reported_at_once():
    declared = "parameters: {a: {type: int, default: 1.5}, b: {type: bool, default: 2}}\n"
    assert faults(declared + "constants: {c: [1, [2, 3]]}\n", "nav_msgs/msg/Nothing") == [
        "main.type", "parameters.a.default", "parameters.b.default", "constants.c",
    ]  # fmt: skip
    wrong = "{set: {field: rangs, value: 1}}, {drop: {}}, {add: {field: angle_min, by: p.a}}"
    actions = f"{{name: a, when: 1, do: [{{drop: {{}}}}]}}, {{name: b, do: [{wrong}]}}"
    assert faults(
        f"transform: {{actions: [{actions}], timer: {{period_s: x, do: [{{drop: {{}}}}]}}}}\n"
    ) == [
        "transform.actions[0].when",
        "transform.actions[1].do[0].set.field",
        "transform.actions[1].do[2].add.by",
        "transform.timer.period_s",
        "transform.timer.do[0].drop",
    ]


@pytest.mark.parametrize(
    "topic",
    ["/cmd_vel", "/cmd_vel_nav", "/robot1/cmd_vel", "/arm/joint_trajectory",
     "/mavros/setpoint_velocity/cmd_vel", "/fmu/in/trajectory_setpoint"],
)  # fmt: skip
def test_a_target_that_moves_something_needs_permission(topic):
    moving = scenario(msgtype="geometry_msgs/msg/Twist")
    moving.document["main"]["output"] = topic
    with pytest.raises(ScenarioError, match="moves nothing"):
        compile_scenario(moving)
    assert compile_scenario(moving, allow_actuation=True).output_topic == topic


@pytest.mark.parametrize("topic", ["/odom", "/_oracle/ground_truth"])
def test_output_is_neither_a_source_nor_the_ground_truth(topic):
    looped = scenario("sources: {odom: {type: nav_msgs/msg/Odometry, topic: /odom}}\n")
    looped.document["main"]["output"] = topic
    with pytest.raises(ScenarioError, match="main"):
        compile_scenario(looped)


def test_a_scenario_that_computes_too_much_is_refused_before_it_runs():
    many = [f"map_array: {{field: {f}, as: [r], value: r + 1}}" for f in ("ranges", "intensities")]
    doing(*many)
    with pytest.raises(
        ScenarioError, match=r"at most [\d,]+ array elements computed .* limits\.array"
    ):
        doing(*many, more="limits: {array: 4194304}\n")
