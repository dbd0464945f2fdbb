"""A system of programs that know nothing of this project, started by the commands of a file."""

import json
import os
import pickle
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import deserialize
from oracle_pipeline.opened_run import open_run
from sim.campaigns import Campaign
from sim.experiments import can_be_rebuilt, recipe_for, record_run
from sim.fuzzing.scenario import ScenarioError
from sim.outside.testbed import read_testbed
from sim.scenarios import scenarios_in
from sim.testbed import Mode
from sim.testbeds import TESTBEDS
from tests.dds_domains import NUMBERS

pytestmark = pytest.mark.slow(20)
TANK = Path(__file__).parents[3] / "examples" / "tank"


@pytest.fixture
def record(tmp_path, monkeypatch):
    """Record a run of the tank, with changes of its file, on a domain that is free."""

    def recorded(mode, **changes):
        system = yaml.safe_load((TANK / "tank.yaml").read_text())
        system |= {"domains": list(NUMBERS), "scenarios": str(TANK / "scenarios"), **changes}
        places = {
            "python3": sys.executable,
            "tank.py": f"{TANK}/tank.py",
            "controller.py": f"{TANK}/controller.py",
        }
        system["start"] = [[places.get(word, word) for word in words] for words in system["start"]]
        file = tmp_path / "tank.yaml"
        file.write_text(json.dumps(system))
        monkeypatch.setitem(TESTBEDS, "tank", read_testbed(file))
        scenario = scenarios_in(Path(system["scenarios"]))[mode].on("tank")
        recipe = recipe_for(Mode(scenario), 0, Campaign())
        directory = RunDirectory(tmp_path / "data", mode, 0)
        record_run(recipe, directory)
        return directory

    return recorded


def test_a_relay_alters_what_a_live_system_gets_and_the_run_is_one_as_any_other(record):
    ends = {"after_s": 12, "within_s": 60}
    run = record("tank_offset", ends=ends)
    manifest = run.manifest()
    assert (manifest.label, manifest.outcome, manifest.onset_s) == ("malicious", "succeeded", 5.0)
    assert 0.9 <= manifest.recipe["values"]["target"] <= 1.1
    assert not can_be_rebuilt(manifest)
    with open_run(run.path) as opened, BagReader(run.bag) as bag:
        assert set(bag.topics) == {"/level", "/level_relayed", "/inflow"}
        values = {"/level": [], "/level_relayed": [], "/inflow": []}
        for topic, _, data in bag.messages():
            values[topic].append(deserialize(data, "std_msgs/msg/Float64").data)
        assert opened.intervals
    # The originals of the first were sent before the recording.
    forwarded = [value in values["/level"] for value in values["/level_relayed"]][10:]
    assert set(forwarded) == {True, False}
    assert forwarded == sorted(forwarded, reverse=True)
    assert manifest.changes[0].start_s == 5.0
    assert manifest.changes[0].largest == pytest.approx(0.2)
    graph = read_gexf(run.graphs / "run.gexf")
    relay = "node:/oracle_relay"
    assert graph.has_edge("topic:/level", relay)
    assert graph.has_edge(relay, "topic:/level_relayed")


def test_in_place_a_scenario_adds_altered_messages_and_the_originals_stay(record, tmp_path):
    scenarios = tmp_path / "scenarios"
    scenarios.mkdir()
    (scenarios / "leak.yaml").write_text("""
        schema: mutant/v1
        id: tank_leak
        title: After 3 s a second sensor reads 20 cm too little
        label: malicious
        main: {type: std_msgs/msg/Float64, input: /level, output: /level}
        activation: {onset: {after: start, seconds: 3}}
        transform:
          actions:
            - {name: offset, do: [{add: {field: data, by: -0.2}}]}
    """)
    run = record(
        "tank_leak",
        scenarios=str(scenarios),
        experiments=["tank_leak"],
        start=[["python3", "tank.py"]],
        ready={"topics": ["/level"], "within_s": 60},
        ends={"after_s": 9, "within_s": 60},  # a relay begins late on a busy machine
    )
    manifest = run.manifest()
    values = numbers(run, "/level")
    originals = {value for value in values if value + -0.2 in values}
    assert values.index(min(values)) > 20, "it began before the onset"
    altered = sum(change.messages for change in manifest.changes)
    assert altered > 20
    assert abs(len(originals) - altered) <= 1, "one may be under way when the recorder ends"
    assert read_gexf(run.graphs / "run.gexf").has_edge("node:/oracle_relay", "topic:/level")


def test_a_task_is_a_message_and_the_run_ends_with_one_when_a_service_was_there(record):
    tank_is_full = """
import time
from number import *
levels, full = reader("level"), writer("full")
request = DataReader(participant, Topic(participant, "rq/emptyRequest", Number))
reply = DataWriter(participant, Topic(participant, "rr/emptyReply", Number))
while True:
    if any(sample.data > 2.0 for sample in levels.take(10)):
        full.write(Number(2.0))
    time.sleep(0.3)
"""
    number = "std_msgs/msg/Float64"
    run = record(
        "tank_normal",
        start=[["python3", "tank.py"], ["python3", "-c", tank_is_full]],
        environment={"PYTHONPATH": str(TANK)},
        ready={"topics": ["/level"], "services": ["/empty"], "within_s": 60},
        task={"topic": {"name": "/inflow", "type": number, "message": {"data": 4}}, "within_s": 5},
        ends={"message": {"topic": "/full", "type": number}, "within_s": 60},
    )
    assert run.manifest().outcome == "succeeded"
    assert set(numbers(run, "/inflow")) == {4.0}
    assert max(numbers(run, "/level")) > 2.0


def test_a_task_is_an_action_of_the_command_line_of_ros_2_and_may_fail(record, tmp_path):
    told = tmp_path / "told"
    ros2 = tmp_path / "ros2"
    ros2.write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" > {told}\nsleep 2\nexit 1\n')
    ros2.chmod(0o755)
    run = record(
        "tank_normal",
        environment={"PATH": f"{tmp_path}:{os.environ['PATH']}"},
        vary={"litres": {"of": [7]}, "target": {"of": [1.0]}},
        task={
            "action": {
                "name": "/fill",
                "type": "tank_msgs/action/Fill",
                "goal": {"to": "{litres}"},
            },
            "within_s": 30,
        },
        ends={"exit": "task", "within_s": 30},
    )
    assert run.manifest().outcome == "aborted"
    expected = ["action", "send_goal", "/fill", "tank_msgs/action/Fill", '{"to": "7"}']
    assert told.read_text().splitlines() == expected


def numbers(run, topic):
    """Return the numbers of a topic of a run."""
    with BagReader(run.bag) as bag:
        return [deserialize(m.data, "std_msgs/msg/Float64").data
                for m in bag.messages() if m.topic == topic]  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"ready": {"topics": ["/level", "/nothing"], "within_s": 2}},
         "`ready` failed: after 2 s, .*no topic /nothing"),
        ({"start": [["python3", "-c", "print('no battery'); raise SystemExit(3)"]]},
         "no battery\nStep `ready` failed: .* has ended with code 3"),
        ({"start": [["there_is_no_such_program"]]}, "`start` failed: .* does not start"),
        ({"start": [["python3", "tank.py"]], "ready": {"topics": ["/level"], "within_s": 60},
          "task": {"command": ["sleep", "60"], "within_s": 1},},
         "`task` failed: after 1 s, `sleep 60` still runs"),
    ],
    ids=["never ready", "crashes", "no program", "task hangs"],
)  # fmt: skip
def test_a_run_that_fails_says_which_step_failed_and_leaves_nothing(
    record, tmp_path, changes, told
):
    with pytest.raises(OracleError, match=told) as failed:
        record("tank_normal", **changes)
    assert str(pickle.loads(pickle.dumps(failed.value))) == str(failed.value)  # noqa: S301
    assert not list((tmp_path / "data").glob("runs/*/run*"))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("stop: {within: 5}", "tank.yaml:11:8: stop.within: expected one of commands, within_s"),
        ("stop: {commands: [[echo, '{speed}']], within_s: 5}", "block, domain, .* found speed"),
        ("stop: !!python/object:os.system {}", "expected plain YAML"),
    ],
)
def test_a_file_with_an_error_is_refused_with_its_place(tmp_path, change, told):
    text = (TANK / "tank.yaml").read_text().replace("stop: {within_s: 5}", change)
    file = tmp_path / "tank.yaml"
    file.write_text(text)
    with pytest.raises(ScenarioError, match=told):
        read_testbed(file)


def test_runs_of_a_block_have_the_same_values_and_those_of_others_differ():
    testbed = read_testbed(TANK / "tank.yaml")
    scenarios = scenarios_in(testbed.scenarios)
    drawn = {
        (name, run): testbed.draw(Mode(scenarios[name]), run, Campaign(), {}).values
        for name in testbed.experiments
        for run in (0, 1)
    }
    assert drawn["tank_normal", 0] == drawn["tank_offset", 0] != drawn["tank_normal", 1]
    recipe = testbed.draw(Mode(scenarios["tank_normal"]), 0, Campaign(), {})
    assert testbed.recipe.from_dict(recipe.to_dict()) == replace(recipe)
