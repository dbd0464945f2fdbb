"""The commands of the scenario language."""

import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

import sim.scenarios
from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.types import TypeDefinition, serialize
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.opened_run import open_run
from sim.commands.kill_matrix import derive_mutant, mutants
from sim.commands.main import main
from sim.commands.parameter_values import BUILT_IN, ParameterError, Sweep, sweeps_of
from sim.experiments import Job
from sim.fuzzing.scenario import parse_scenarios
from sim.modes import FOLDER, find_mode
from sim.scenarios import builtin_scenarios
from tests.sim.fuzzing.workbench import BUILTINS, SCAN, scans

pytestmark = pytest.mark.slow

BUILTIN_FILE = Path(sim.scenarios.__file__).with_name("random_noise.yaml")
FOREIGN = "made_up_msgs/msg/Reading"
READINGS = [(number * 10**9 + 1, b"\0\1\0\0reading" + bytes([number])) for number in range(9)]
OWN = """\
schema: mutant/v1
id: my_drift
title: Mine
label: malicious
main: {type: sensor_msgs/msg/LaserScan, input: /scan_tom, output: /scan_fakeobject}
parameters:
  rate: {type: float, default: 0.1, min: 0.0, unit: m/s}
transform:
  actions:
    - {name: drift, do: [{drift: {field: ranges, rate: p.rate}}]}
"""


def run(*words, expect=0):
    done = CliRunner().invoke(main, [str(word) for word in words])
    assert done.exit_code == expect, done.output
    return done


def messages(path, *topics):
    with BagReader(path) as bag:
        return list(bag.messages(topics or None))


@pytest.fixture(params=["mcap", "sqlite3"])
def foreign_bag(request, tmp_path):
    """A bag of a foreign robot, with messages of an unknown type."""
    with BagWriter(tmp_path / "foreign", request.param) as bag:
        bag.add_topic("/scan_tom", SCAN, [])
        bag.add_topic("/reading", FOREIGN, [], TypeDefinition("uint8[] data\n", ""))
        bag.add_topic("/nameless", "made_up_msgs/msg/Nameless", [], TypeDefinition("", ""))
        for (stamp_ns, data), scan in zip(READINGS, scans(len(READINGS)), strict=True):
            bag.write("/scan_tom", stamp_ns, serialize(scan, SCAN))
            bag.write("/reading", stamp_ns, data)
            bag.write("/nameless", stamp_ns, data)
    return tmp_path / "foreign"


def test_mutate_copies_unaltered_messages_even_of_unknown_types(foreign_bag, tmp_path):
    out = tmp_path / "out"
    done = run("mutate", foreign_bag, out, "random_noise", "-p", "level=0.5", "--at", 3.0)
    text = (
        "attack from 3.0 s on; of 9 messages of /scan_tom, 6 affected; 9 published on /scan_fakeo"
    )
    assert text in done.output
    untouched = ("/reading", "/nameless", "/scan_tom")
    assert messages(out, *untouched) == messages(foreign_bag)
    with BagReader(foreign_bag) as before, BagReader(out) as after:
        assert after.definition(FOREIGN).text == before.definition(FOREIGN).text == "uint8[] data\n"
    expected = dict.fromkeys([*untouched, "/scan_fakeobject", "/_oracle/ground_truth"], 9)
    with Reader(out) as bag:
        assert Counter(connection.topic for connection, _, _ in bag.messages()) == expected
    for file in out.glob("*.mcap"):
        with file.open("rb") as stream:
            found = [channel.topic for _, channel, _ in make_reader(stream).iter_messages()]
        assert Counter(found) == expected


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["no_such"], "neither a scenario nor a file no_such"),
        (["random_noise", "-p", "level=2"], "level: expected 0.0 to 1.0, found 2.0"),
        (["odometry_spoof"], "has no topic /odom, which odometry_spoof subscribes to"),
        (["sensor_freeze"], "does not show when goal 1 was accepted"),
        (["command_injection"], "main.output: expected a topic that moves nothing"),
    ],
)
def test_mutate_reports_the_fault_and_writes_nothing(words, expected, foreign_bag, tmp_path):
    done = run("mutate", foreign_bag, tmp_path / "out", *words, expect=1)
    assert expected in done.output
    assert not (tmp_path / "out").exists()


def test_mutate_points_a_scenario_at_a_topic_and_alters_it_in_place(foreign_bag, tmp_path):
    noisy, twice = tmp_path / "noisy", tmp_path / "twice"
    words = ("-p", "level=0.5", "--at", 3.0)
    done = run("mutate", foreign_bag, noisy, "random_noise", *words, "--topic", "/scan_tom")
    assert "of 9 messages of /scan_tom, 6 affected; 9 published on /scan_tom" in done.output
    with BagReader(foreign_bag) as before, BagReader(noisy) as after:
        assert after.topics.keys() == before.topics.keys()
        pairs = list(
            zip(before.messages(["/scan_tom"]), after.messages(["/scan_tom"]), strict=True)
        )
    assert [b.data != a.data for b, a in pairs] == [False] * 3 + [True] * 6
    run("mutate", noisy, twice, "delayed_passthrough", "--at", 3.0, "--topic", "/scan_tom",
        "--topic", "odom=/reading", expect=1)  # fmt: skip


def test_mutate_finds_topics_without_leading_slash_and_tells_what_it_leaves_out(tmp_path):
    bag, out = tmp_path / "bag", tmp_path / "out"
    with BagWriter(bag) as writer:
        for name, count in {"scan": 9, "/scan": 4}.items():
            writer.add_topic(name, SCAN, [])
            for stamp_ns, scan in enumerate(scans(count), start=1):
                writer.write(name, stamp_ns, serialize(scan, SCAN))
    done = run("mutate", bag, out, "random_noise", "--topic", "/scan")
    assert "of 9 messages of /scan, 9 affected; 9 published on /scan" in done.stdout
    assert "and as /scan (sensor_msgs/msg/LaserScan); the 4 messages of the latter" in done.stderr
    with Reader(out) as reader:
        topics = Counter(connection.topic for connection, _, _ in reader.messages())
    assert topics == {"/scan": 9, "/_oracle/ground_truth": 9}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ["random_noise", "--topic", "/none"],
            "has no topic /none, which random_noise subscribes to",
        ),
        (["random_noise", "--topic", "/reading"], "random_noise needs sensor_msgs/msg/LaserScan"),
        (
            ["fake_object", "--topic", "gps=/fix"],
            "does not subscribe to gps; it subscribes to main, odom",
        ),
        (["message_mutator", "--topic", "/cmd_vel"], "would alter /cmd_vel, which may move"),
    ],
)
def test_mutate_names_the_topic_that_does_not_fit(words, expected, foreign_bag, tmp_path):
    assert expected in run("mutate", foreign_bag, tmp_path / "out", *words, expect=1).output


def test_messages_before_the_onset_stay_as_recorded(foreign_bag, tmp_path):
    file = tmp_path / "late.yaml"
    file.write_text(OWN + "activation: {before: absent}\n")
    out = tmp_path / "out"
    run("mutate", foreign_bag, out, file, "--topic", "/scan_tom", "--at", 3.0)
    before, after = messages(foreign_bag, "/scan_tom"), messages(out, "/scan_tom")
    assert len(after) == len(before)


def test_mutate_takes_one_scenario_of_a_file_that_holds_several(foreign_bag, tmp_path):
    file = tmp_path / "two.yaml"
    file.write_text(OWN + "---\n" + OWN.replace("my_drift", "other"))
    done = run("mutate", foreign_bag, tmp_path / "out", file, expect=1)
    assert "holds my_drift, other" in done.output
    run("mutate", foreign_bag, tmp_path / "out", f"{file}#other")


def test_a_valid_file_is_accepted_and_an_invalid_one_reported_with_line_and_key(tmp_path):
    right, wrong, mistyped = (tmp_path / f"{name}.yaml" for name in ("right", "wrong", "mistyped"))
    right.write_text(OWN)
    wrong.write_text(OWN.replace("label: malicious", "label: evil"))
    mistyped.write_text(OWN.replace("p.rate", "p.name"))
    assert "my_drift is correct" in run("scenario", "check", right).output
    done = run("scenario", "check", wrong, right, mistyped, tmp_path / "none.yaml", expect=1)
    assert "my_drift is correct" in done.output
    lines = done.stderr.splitlines()
    assert len(lines) == 3
    assert lines[0].startswith(f"{wrong}:4:1: label: expected one of malicious, normal, control")
    assert re.match(
        rf"{re.escape(str(mistyped))}:10:\d+: transform\.actions\[0\]\.do\[0\]", lines[1]
    )
    assert lines[2].startswith(f"Could not read {tmp_path / 'none.yaml'}")


def test_a_scenario_that_moves_something_needs_permission(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text(run("scenario", "show", "command_injection").output)
    assert "moves nothing" in run("scenario", "check", file, expect=1).output
    run("scenario", "check", file, "--allow-actuation")
    words = ("grid", "--over", "turn=0:1:2", file, "--out", tmp_path)
    assert "moves nothing" in run(*words, expect=1).output


@pytest.mark.parametrize("name", [*BUILTINS, "fake_object_shadow"])
def test_the_shown_text_is_the_scenario(name):
    (shown,) = parse_scenarios(run("scenario", "show", name).output.encode(), "shown.yaml")
    assert shown.digest == find_mode(name, allow_actuation=True).scenario.digest


def test_the_list_has_the_built_in_scenarios_and_the_users(tmp_path, monkeypatch):
    (tmp_path / "own.yaml").write_text(OWN)
    (tmp_path / "broken.yaml").write_text("nothing")
    monkeypatch.setenv(FOLDER, str(tmp_path))
    done = run("scenario", "list", "--format", "json")
    assert "broken.yaml:1" in done.stderr
    listed = {row["id"]: row for row in json.loads(done.stdout)}
    assert set(listed) == {*builtin_scenarios(), "my_drift"}
    assert listed["my_drift"] == {
        "id": "my_drift",
        "title": "Mine",
        "label": "malicious",
        "type": SCAN,
        "input": "/scan_tom",
        "output": "/scan_fakeobject",
        "parameters": {"rate": "0.1 (from 0.0 m/s)"},
        "is_mode": True,
    }
    assert listed["random_noise"]["parameters"] == {"level": "0.1 (0.0 to 1.0)"}
    text = run("scenario", "list").stdout
    assert all(name in text for name in listed)


def test_a_grid_has_every_value_in_every_block_and_grows_by_blocks(tmp_path):
    sweeps = [Sweep("level", (0.1, 0.2)), Sweep("rays", (3,))]
    mode = find_mode("random_noise")
    cells = mutants(mode, tmp_path, sweeps, 3)
    assert [cell.run for cell in cells] == list(range(9))
    assert cells[:6] == mutants(mode, tmp_path, sweeps, 2)
    assert {(cell.block, *cell.given.items()) for cell in cells} == {
        (block, (name, value))
        for block in range(3)
        for name, value in (("level", 0.1), ("level", 0.2), ("rays", 3))
    }


def test_a_grid_is_indexed_as_far_as_there_are_runs_with_its_equivalent_mutants(controls, tmp_path):
    words = ["random_noise", "--over", "level=0:0.1:2", "--blocks", 2, "--on", controls]
    root = tmp_path / "grid"
    done = run("grid", *words, "--out", root, "--workers", 1, expect=1)
    assert "2 of 4 runs failed" in done.stderr
    assert f"random_noise|run003: Could not read {controls / 'run001'}" in done.stderr
    index = json.loads((root / "grid.json").read_text())
    heard = len(messages(controls / "run000/bag", "/scan_tom"))
    same = {"scenario": "random_noise", "parameter": "level", "block": 0}
    assert index == [
        {**same, "run_id": "random_noise|run000", "value": 0.0, "path": "runs/random_noise/run000",
         "changed_messages": 0, "equivalent": True},
        {**same, "run_id": "random_noise|run001", "value": 0.1, "path": "runs/random_noise/run001",
         "changed_messages": heard, "equivalent": False},
    ]  # fmt: skip


def test_a_mutant_of_a_run_is_a_run_of_its_block(controls, tmp_path):
    mode = find_mode("fake_object")
    manifest = derive_mutant(controls, False, Job(mode, tmp_path, 7, 0, {"radius": 0.3}))
    original = Manifest.load(controls / "run000" / "manifest.json")
    with open_run(tmp_path / "runs/fake_object/run007") as opened:
        assert opened.manifest == manifest
        assert len(opened.intervals) > 0
    assert (manifest.mode, manifest.label, manifest.run) == ("fake_object", "malicious", 7)
    assert (manifest.block, manifest.session, manifest.start, manifest.goals) == (
        original.block, original.session, original.start, original.goals,
    )  # fmt: skip
    assert manifest.attack["radius"] == 0.3
    assert np.hypot(manifest.attack["x"], manifest.attack["y"]) < 10.0  # the block's
    changed = sum(change.messages for change in manifest.changes)
    assert 0 < changed <= len(messages(controls / "run000/bag", "/scan_tom"))


def test_an_existing_mutant_is_kept_and_not_replaced_by_another(controls, tmp_path):
    mode = find_mode("sensor_drop")
    job = Job(mode, tmp_path, 0, 0, {"share": 0.5})
    made = derive_mutant(controls, False, job)
    again = derive_mutant(controls, False, job)
    assert again == made  # wall time included
    other = Job(mode, tmp_path, 0, 0, {"share": 0.6})
    with pytest.raises(RunDirectoryError, match="holds another mutant"):
        derive_mutant(controls, False, other)
    remade = derive_mutant(controls, True, other)
    assert remade.attack == {"share": 0.6}
    assert remade.attack_seed == made.attack_seed


@pytest.mark.parametrize("name", [
    name for name, scenario in builtin_scenarios().items() if scenario.label == "malicious"
])  # fmt: skip
def test_every_built_in_attack_has_magnitudes_or_is_listed_as_without(name):
    mode = find_mode(name, allow_actuation=True)
    if BUILT_IN.get(name, "") is None:
        with pytest.raises(ParameterError, match=f"{name} has no magnitude"):
            sweeps_of(mode)
        return
    (found,) = sweeps_of(mode)
    assert len(found.values) >= 5
    assert list(found.values) == sorted(set(found.values))


def test_a_users_scenario_is_swept_in_each_number_with_bounds(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text(OWN.replace("min: 0.0", "min: 0.01, max: 0.5"))
    (found,) = sweeps_of(find_mode(str(file)))
    assert (found.parameter, found.values[0], found.values[-1]) == ("rate", 0.01, 0.5)
    assert len(found.values) == 8
    file.write_text(OWN)
    with pytest.raises(ParameterError, match="no number with a min and a max"):
        sweeps_of(find_mode(str(file)))


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        ([], 2, "Name a SCENARIO, or give --all"),
        (["random_noise", "--all"], 2, "Name a SCENARIO, or give --all"),
        (["--all", "--over", "level=0:1:2"], 2, "--all without --over"),
        (["sensor_freeze"], 1, "sensor_freeze has no magnitude"),
        (["--all", "--on", "."], 1, "Could not read run000"),
    ],
)
def test_a_grid_with_invalid_options_states_the_valid_ones(words, code, expected):
    assert expected in run("grid", *words, expect=code).stderr


@pytest.mark.parametrize(
    "words", [["mutate"], ["scenario", "check"], ["scenario", "list"], ["scenario", "show"],
              ["grid"]],
    ids=" ".join,
)  # fmt: skip
def test_every_command_has_an_example(words):
    assert f"oracle-sim {' '.join(words)} " in run(*words, "--help").output


def test_a_check_shows_each_parameter_with_its_range_and_unit():
    checked = run("scenario", "check", BUILTIN_FILE.with_name("blinded_sector.yaml"))
    assert "    half_width = 0.52 (0.0 to 3.15 rad)\n" in checked.output


def test_a_check_starts_without_testbeds_and_without_the_analysis():
    heavy = ("mujoco", "pandas", "networkx", "dagster", "matplotlib", "sim.experiments")
    code = f"""
import sys
from sim.commands.main import main
try:
    main(["scenario", "check", {str(BUILTIN_FILE)!r}])
finally:
    print(*(name for name in {heavy} if name in sys.modules), file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "random_noise is correct; a message takes at most 0.20% of the " in done.stdout
    assert "    level = 0.1 (0.0 to 1.0)\n" in done.stdout
    assert done.stderr.strip() == ""
