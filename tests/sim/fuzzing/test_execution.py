"""Execution of programs: laws for all of them, and the semantics of the language."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.fuzzing.compilation import compile_scenario
from sim.scenarios import builtin_scenarios
from tests.sim.fuzzing.workbench import (
    BUILTINS,
    REPORT,
    builtin,
    data,
    doing,
    examples,
    frozen,
    only,
    program,
    report,
    results,
    scan,
    scans,
    stamp,
    start,
)

# What every program owes.


@pytest.mark.parametrize("name", BUILTINS)
def test_no_program_writes_to_received_messages(name):
    compiled = builtin(name)
    messages = examples(compiled)
    before = [data(message) for message in frozen(messages)]
    results(compiled, messages)
    assert [data(message) for message in messages] == before


@pytest.mark.parametrize("name", BUILTINS)
def test_the_same_run_gives_the_same_bytes_and_another_seed_may_not(name):
    compiled = builtin(name)

    def told(seed):
        found = results(compiled, examples(compiled), seed)
        return [[(due, data(m)) for due, m, _ in r.outputs] + [r.truth] for r in found]

    assert told(1) == told(1)
    noise = {"random_noise", "random_noise_thesis", "benign_noise"}
    drawing = noise | {"sensor_drop", "sensor_delay", "message_mutator", "benign_drop"}
    drawing |= {"odometry_reordered", "scan_link_drop", "infrared_ghost"}
    assert (told(1) != told(2)) == (name in drawing)


@pytest.mark.parametrize("name", BUILTINS)
def test_a_shadow_does_the_same_work_and_publishes_what_came(name):
    attack = builtin(name)
    shadow = compile_scenario(builtin_scenarios()[name].as_shadow(), allow_actuation=True)
    messages = examples(attack)
    done, withheld = results(attack, messages), results(shadow, messages)
    for number, message in enumerate(messages):
        ((due_ns, output, _),) = withheld[number].outputs
        assert due_ns == stamp(number)
        assert output is message
        truth = withheld[number].truth
        assert (truth.operation, truth.magnitude) == (done[number].truth.operation, 0.0)


@pytest.mark.parametrize("name", ["random_noise", "random_noise_thesis", "message_mutator"])
@given(lost=st.sets(st.integers(0, 19)))
def test_the_result_for_a_message_does_not_depend_on_lost_ones(name, lost):
    compiled = builtin(name)
    messages = list(scans(20))
    whole = results(compiled, messages)
    execution = start(compiled)
    for number, message in enumerate(messages):
        if number not in lost:
            ((_, output, _),) = execution.on_message(message, stamp(number), 0.2 * number).outputs
            assert data(output) == data(whole[number].outputs[0].message)


@pytest.mark.parametrize("name", BUILTINS)
def test_before_its_onset_a_program_forwards_every_message(name):
    execution = start(builtin(name))
    (message,) = examples(execution.program, 1)
    ((_, output, _),) = execution.on_message(message, stamp(0), -0.1).outputs
    assert output is message
    assert execution.on_timer(stamp(0), -0.1).outputs == []


def test_messages_without_a_stamp_draw_by_their_number():
    compiled = doing("noise: {field: ranges, dist: uniform, relative: 0.1}")
    unstamped = replace(scan(), header=scan(-1).header)
    first, second = results(compiled, [unstamped, unstamped])
    assert data(first.outputs[0].message) != data(second.outputs[0].message)


@pytest.mark.parametrize("control", ["passthrough", "shadow"])
def test_the_timer_of_a_control_publishes_nothing(control):
    document = {**builtin_scenarios()["atc_ghost_static"].document, "control": control}
    ghost = replace(builtin_scenarios()["atc_ghost_static"], document=document)
    assert start(compile_scenario(ghost)).on_timer(stamp(5), 1.0).outputs == []


# The language.


def test_all_values_of_an_action_read_the_original():
    report_ = report(0, latitude=1.0, longitude=2.0)
    swap = doing(
        "set: {field: latitude, value: msg.longitude}",
        "set: {field: longitude, value: msg.latitude}",
        msgtype=REPORT,
    )
    heard = only(swap, report_)
    assert (heard.latitude, heard.longitude) == (2.0, 1.0)


TWO_ACTIONS = """\
transform:
  match: {match}
  actions:
    - name: one
      do: [{{add: {{field: altitude_m, by: 1.0}}}}]
    - name: never
      when: msg.altitude_m < 0.0
      do: [{{drop: {{}}}}]
    - name: two
      do: [{{scale: {{field: altitude_m, by: 10.0}}}}]
"""


@pytest.mark.parametrize(
    ("match", "altitude_m", "operation"), [("first", 3.0, "one"), ("all", 30.0, "one+two")]
)
def test_the_first_action_that_matches_is_done_or_all_one_after_the_other(
    match, altitude_m, operation
):
    (result,) = results(
        program(TWO_ACTIONS.format(match=match), REPORT), [report(0, altitude_m=2.0)]
    )
    assert result.outputs[0].message.altitude_m == altitude_m
    assert result.truth.operation == operation


def test_state_is_kept_from_message_to_message():
    compiled = program(
        """\
state: {count: {type: int, default: 0}}
transform:
  always:
    - store: {into: count, value: state.count + 1}
    - set: {field: altitude_m, value: state.count}
""",
        REPORT,
    )
    for _ in range(2):  # a second run begins anew
        found = results(compiled, [report(n) for n in range(3)])
        assert [r.outputs[0].message.altitude_m for r in found] == [1.0, 2.0, 3.0]


def test_a_full_table_gives_up_the_row_that_was_stored_first():
    compiled = program(
        """\
state: {seen: {type: map, value: {count: int}, max_size: 2}}
transform:
  always:
    - store:
        into: seen
        key: msg.icao24
        value: {count: "state.seen[msg.icao24].count + 1"}
    - set: {field: altitude_m, value: "state.seen[msg.icao24].count"}
""",
        REPORT,
    )
    addresses = ["a", "b", "a", "c", "b", "a"]
    found = results(compiled, [report(n, icao24) for n, icao24 in enumerate(addresses)])
    counts = [result.outputs[0].message.altitude_m for result in found]
    assert counts == [1.0, 1.0, 2.0, 1.0, 1.0, 1.0]


def test_a_window_and_a_probability_limit_what_is_touched():
    compiled = program(
        """\
activation: {duration_s: 40.0, probability: 0.5}
transform: {actions: [{name: hide, do: [{drop: {}}]}]}
"""
    )
    found = results(compiled, [scan(n) for n in range(300)])
    dropped = [n for n, result in enumerate(found) if not result.outputs]
    assert 70 <= len(dropped) <= 130
    assert max(dropped) < 200


def test_a_stale_source_may_drop_the_message():
    rest = """\
sources:
  odom: {type: nav_msgs/msg/Odometry, topic: /odom, max_age: 0.3, on_missing: drop}
transform: {actions: [{name: slow, do: [{scale: {field: ranges, by: 2.0}}]}]}
"""
    execution = start(program(rest))
    assert len(execution.on_message(scan(1), stamp(1), 0.2).outputs) == 1
    late = execution.on_message(scan(2), stamp(2), 0.4)
    assert late.outputs == []
    assert late.truth.detail == "dropped: odom is 0.4 s old"


def test_an_array_longer_than_allowed_is_forwarded_with_a_note_in_the_ground_truth():
    compiled = doing("scale: {field: ranges, by: 2.0}", more="limits: {array: 100}\n")
    message = scan()
    (result,) = results(compiled, [message])
    assert result.outputs[0].message is message
    assert result.truth.detail == "ranges has 360 elements, limits.array is 100"


def test_the_truth_counts_what_was_published_before():
    found = results(doing("duplicate: {copies: 3}"), [scan(n) for n in range(3)])
    assert [result.truth.index for result in found] == [0, 3, 6]


def test_a_scenario_may_define_its_magnitude():
    more = "parameters: {m: {type: float, default: 4.5}}\nground_truth: {magnitude: p.m}\n"
    (result,) = results(doing("drop: {}", more=more), [scan()])
    assert result.truth.magnitude == 4.5


def test_no_more_is_published_for_a_message_than_allowed():
    compiled = doing("duplicate: {copies: 500}", more="limits: {outputs: 10}\n")
    ((result),) = results(compiled, [scan()])
    assert len(result.outputs) == 10
