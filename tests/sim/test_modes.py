"""The modes, their scenarios, and those that a user's folder adds."""

import re
from pathlib import Path

import numpy as np
import pytest

from oracle_pipeline.bags.protocol import PAIRS
from sim.campaigns import Campaign
from sim.experiments import recipe_for
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.scenario import ScenarioError
from sim.modes import FOLDER, find_mode, left_out, modes
from sim.scenarios import builtin_scenarios
from sim.testbeds import TESTBEDS, which_testbed
from tests.sim.fuzzing.workbench import INCREMENT, only, scan

SIX = [
    "lidar_passthrough", "lidar_passthrough_odom", "fake_object", "random_noise",
    "delayed_passthrough", "delayed_fakeobject",
]  # fmt: skip
OWN = """\
schema: mutant/v1
id: {name}
label: malicious
main: {{type: sensor_msgs/msg/LaserScan, input: /scan_tom, output: /scan_fakeobject}}
transform:
  actions:
    - {{name: nearer, do: [{{scale: {{field: ranges, by: {by}}}}}]}}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The user's folder of scenario files."""
    monkeypatch.setenv(FOLDER, str(tmp_path))
    return tmp_path


def test_the_six_come_first_then_the_others_of_their_testbed_then_other_testbeds():
    names = list(modes())
    assert names[:6] == SIX
    benches = [which_testbed(mode.scenario) for mode in modes().values()]
    assert benches == sorted(benches, key=list(TESTBEDS).index)
    assert names[benches.index("atc")] == "atc_normal"


def test_every_mode_goes_by_the_name_of_its_scenario():
    assert all(name == mode.id for name, mode in modes().items())


def test_pairs_are_a_normal_and_a_malicious_mode():
    known = modes()
    assert [(known[a].label, known[b].label) for a, b in PAIRS] == [("normal", "malicious")] * 3


@pytest.mark.parametrize("name", modes())
def test_every_attack_has_a_shadow_that_differs_in_what_it_publishes_only(name):
    mode = modes()[name]
    if mode.label == "malicious":
        shadow = modes()[f"{name}_shadow"]
        own = ("id", "title", "label", "control")
        assert shadow.label == shadow.scenario.document["control"].replace("shadow", "control")
        assert {k: v for k, v in shadow.scenario.document.items() if k not in own} == {
            k: v for k, v in mode.scenario.document.items() if k not in own
        }
    else:
        assert f"{name}_shadow" not in modes()


@pytest.mark.parametrize("name", modes())
def test_every_mode_compiles_and_its_graph_is_that_of_its_testbed(name):
    scenario = modes()[name].scenario
    program = compile_scenario(scenario)
    ends = {"turtlebot3": ("/scan_tom", "/scan_fakeobject"), "atc": ("/adsb", "/adsb_fuzzed")}
    if between := ends.get(which_testbed(scenario)):
        assert (program.input_topic, program.output_topic) == between
    else:
        assert program.is_in_place


@pytest.mark.parametrize("pair", PAIRS)
def test_the_nodes_of_a_pair_have_equal_subscriptions_and_graphs(pair):
    control, attack = (compile_scenario(modes()[name].scenario) for name in pair)
    assert {s.topic for s in control.sources.values()} == {s.topic for s in attack.sources.values()}
    assert control.activation == attack.activation


def test_hard_negatives_are_normal_and_three_of_them_change_the_testbed():
    hard = {name: mode for name, mode in modes().items() if name.startswith("benign_")}
    assert {mode.label for mode in hard.values()} == {"normal"}
    assert {name: mode.conditions for name, mode in hard.items() if mode.conditions} == {
        "benign_obstacle": {"obstacle": True},
        "benign_slow": {"speed": 0.6},
        "benign_pedestrian": {"pedestrian": True},
    }


def test_scenarios_of_the_users_folder_are_modes_before_air_traffic(folder):
    (folder / "own.yaml").write_text(OWN.format(name="nearer", by=0.9))
    (folder / "two.yml").write_text(
        OWN.format(name="nearest", by=0.5) + "---\n" + OWN.format(name="far", by=2.0)
    )
    names = list(modes())
    assert names[names.index("benign_pedestrian") + 1 : names.index("atc_normal")] == [
        "nearer", "nearest", "far"
    ]  # fmt: skip
    assert modes()["nearer"].label == "malicious"
    assert left_out() == ()


def test_a_broken_file_is_named_with_its_line_and_the_others_still_load(folder):
    (folder / "a.yaml").write_text(OWN.format(name="first", by="p.nothing"))
    (folder / "b.yaml").write_text("schema: mutant/v1\n")
    (folder / "c.yaml").write_text(OWN.format(name="fake_object", by=0.9))
    (folder / "d.yaml").write_text(OWN.format(name="good", by=0.9))
    assert "good" in modes()
    assert "first" not in modes()
    compiled, schema, taken = left_out()
    assert compiled.startswith(f"{folder}/a.yaml:7:51: transform.actions[0].do[0].scale.by:")
    assert schema.startswith(f"{folder}/b.yaml:1:1:")
    assert taken.startswith(f"{folder}/c.yaml:2:1: id: expected a new name")
    assert modes()["fake_object"].scenario is builtin_scenarios()["fake_object"]


def test_a_missing_folder_is_an_error(monkeypatch):
    monkeypatch.setenv(FOLDER, "/nowhere")
    assert list(modes())[:6] == SIX
    (text,) = left_out()
    assert text.startswith("ORACLE_SCENARIOS is /nowhere, which is no folder")


def test_a_scenario_that_is_no_mode_is_found_by_name_by_file_and_by_its_place_in_one(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text(OWN.format(name="one", by=0.9))
    assert find_mode(str(file)).id == "one"
    file.write_text(OWN.format(name="one", by=0.9) + "---\n" + OWN.format(name="two", by=0.9))
    assert find_mode(f"{file}#two").id == "two"
    assert find_mode("sensor_freeze").id == "sensor_freeze"
    assert "sensor_freeze" not in modes()
    assert find_mode("benign_slow").conditions == {"speed": 0.6}


@pytest.mark.parametrize(
    ("name", "text"),
    [("nothing", "neither a scenario nor a file"), ("{file}", "choose one as"),
     ("{file}#three", "holds one, two"), ("command_injection", "allow it with --allow-actuation")],
)  # fmt: skip
def test_an_unknown_or_invalid_scenario_is_refused(tmp_path, name, text):
    file = tmp_path / "own.yaml"
    file.write_text(OWN.format(name="one", by=0.9) + "---\n" + OWN.format(name="two", by=0.9))
    with pytest.raises(ScenarioError, match=text):
        find_mode(name.format(file=file))
    assert find_mode("command_injection", allow_actuation=True).label == "malicious"


def test_a_parameter_drawn_from_what_the_other_testbed_has_is_refused(tmp_path):
    file = tmp_path / "own.yaml"
    drawn = "parameters: {who: {type: string, default: A, drawn: target_icao24}}\n"
    file.write_text(OWN.format(name="own", by=0.9) + drawn)
    with pytest.raises(ScenarioError, match=r"who.drawn: .*object_x, object_y, object_radius"):
        recipe_for(find_mode(str(file)), 0, Campaign())


# docs/reference/modes.md

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "modes.md"


def test_the_page_lists_every_mode_of_the_first_testbed_in_order_with_its_label():
    rows = re.findall(r"^\| `(\w+)` \| (malicious|normal|control) \|", PAGE.read_text(), re.M)
    listed = [name for name in modes() if which_testbed(modes()[name].scenario) == "turtlebot3"]
    assert rows == [(name, modes()[name].label) for name in listed]


def test_the_scenario_on_the_page_is_a_mode_of_the_folder_that_holds_it(folder):
    (document,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(), re.S)
    (folder / "phantom_wall.yaml").write_text(document)
    assert "phantom_wall" in modes()
    wall = compile_scenario(modes()["phantom_wall"].scenario)
    ahead = only(wall, scan(0, np.full(360, 2.0)), distance=0.8, length=1.0).ranges
    hit = ahead < 2.0
    bearings = INCREMENT * np.flatnonzero(hit)
    np.testing.assert_allclose(ahead[hit] * np.cos(bearings), 0.8, atol=1e-6)
    assert np.abs(ahead[hit] * np.sin(bearings)).max() == pytest.approx(0.5, abs=0.02)
