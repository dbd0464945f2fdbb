"""What every testbed supplies, built in or plugged in, and how one is found."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.retention import retain
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.sources import dependencies
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from sim.campaigns import Campaign
from sim.experiments import can_be_rebuilt, recipe_for, recipe_of, record_run, remake_run
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.scenario import ScenarioError
from sim.modes import FOLDER, left_out, modes
from sim.scenarios import scenarios_in
from sim.testbed import Mode
from sim.testbeds import BUILT_IN, GROUP, TESTBEDS, load_testbeds, which_testbed

SHORT = Campaign(goals_per_run=1, timeout_s=3.0)
EXAMPLE = Path(__file__).parents[2] / "examples" / "cart"
PLUGIN = "cart"


@pytest.fixture
def testbed(request, monkeypatch):
    """The testbed of a name; the plug-in is loaded as an installed one is."""
    if request.param == PLUGIN:
        monkeypatch.syspath_prepend(EXAMPLE)
        loaded, broken = load_testbeds([EntryPoint(PLUGIN, "cart.testbed:CART", GROUP)])
        assert broken == ()
        monkeypatch.setitem(TESTBEDS, PLUGIN, loaded[PLUGIN])
    return request.param


def mode_of(name):
    """Return the first experiment of a testbed."""
    testbed = TESTBEDS[name]
    scenario = scenarios_in(testbed.scenarios)[testbed.experiments[0]]
    return Mode(scenario if which_testbed(scenario) == name else scenario.on(name))


@pytest.mark.slow(10)
@pytest.mark.parametrize("testbed", [*BUILT_IN, PLUGIN], indirect=True)
def test_every_testbed_keeps_the_contract(testbed, tmp_path):
    about, mode = TESTBEDS[testbed], mode_of(testbed)
    recipe = recipe_for(mode, 0, SHORT)
    directory = RunDirectory(tmp_path, mode.id, 0)
    manifest = record_run(recipe, directory)
    # Its recipe says where it is from, determines it, and covers the module that executes it.
    assert recipe_of(manifest) == recipe
    assert which_testbed(mode.scenario) == testbed
    assert recipe.campaign().seed == SHORT.seed
    run = about.bring_up(recipe, tmp_path)
    assert type(run).__module__ == about.made_by
    assert Path(sys.modules[about.made_by].__file__) in dependencies([about.made_by])
    # What the mode's node reads and publishes is recorded, and in the graph; ground truth is apart.
    program = compile_scenario(mode.scenario)
    assert GROUND_TRUTH_TOPIC in manifest.topics
    with BagReader(directory.bag) as bag:
        assert {program.input_topic, program.output_topic} <= bag.topics.keys()
        assert GROUND_TRUTH_TOPIC not in bag.topics
    graph = read_gexf(directory.graphs / "run.gexf")
    assert {f"topic:{program.input_topic}", f"topic:{program.output_topic}"} <= set(graph)
    assert f"topic:{GROUND_TRUTH_TOPIC}" not in graph
    # A bag that was dropped comes back with the same messages; else it may not be dropped.
    assert can_be_rebuilt(manifest) == about.deterministic
    if about.deterministic:
        dropped = retain(directory, "recipe", lambda _: ())
        assert not any(directory.bag.glob("*.mcap"))
        assert remake_run(dropped, directory).content_hash == manifest.content_hash


def test_every_experiment_is_run_on_the_testbed_that_names_it():
    for name, testbed in TESTBEDS.items():
        named = [*testbed.experiments, *testbed.hard_negatives]
        assert {which_testbed(modes()[mode].scenario) for mode in named} == {name}


def test_a_scenario_that_names_none_runs_where_its_messages_are_or_else_on_the_first():
    scenario = mode_of("atc").scenario
    main = {**scenario.document["main"], "type": "sensor_msgs/msg/Imu"}
    imu = replace(scenario, document={**scenario.document, "main": main})
    assert which_testbed(imu) == next(iter(TESTBEDS))
    assert which_testbed(imu.on("atc")) == "atc"
    with pytest.raises(ScenarioError, match="There is no testbed 'none'; there are turtlebot3"):
        which_testbed(imu.on("none"))


def test_a_plugin_that_is_broken_costs_itself_only(monkeypatch, tmp_path):
    places = {"gone": "nowhere.at_all:X", "odd": "sim.seeds:BLOCK", "atc": "cart.testbed:CART"}
    monkeypatch.syspath_prepend(EXAMPLE)
    named = [("atc", BUILT_IN["atc"]), *places.items()]
    loaded, broken = load_testbeds(EntryPoint(*each, GROUP) for each in named)
    assert list(loaded) == ["atc"]
    gone, odd, taken = broken
    assert "gone (nowhere.at_all:X)" in gone
    assert "No module named 'nowhere'" in gone
    assert "expected a sim.testbed.Testbed, found int" in odd
    assert "there is a testbed of this name already" in taken


def test_a_scenario_of_a_testbed_that_is_not_there_is_left_out(monkeypatch, tmp_path):
    text = (EXAMPLE / "cart/scenarios/cart.yaml").read_text().partition("---")[0]
    (tmp_path / "gone.yaml").write_text(f"{text}testbed: gone\n")
    monkeypatch.setenv(FOLDER, str(tmp_path))
    (told,) = left_out()
    assert "gone.yaml" in told
    assert "There is no testbed 'gone'" in told


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install the example, as pip does, for processes that are started here."""
    site = tmp_path / "site"
    shutil.copytree(EXAMPLE / "cart", site / "cart")
    about = site / "oracle_cart-0.1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: oracle-cart\nVersion: 0.1.0\n")
    (about / "entry_points.txt").write_text(f"[{GROUP}]\ncart = cart.testbed:CART\n")
    monkeypatch.setenv("PYTHONPATH", str(site))


def oracle_sim(*words, cwd):
    command = [Path(sys.executable).with_name("oracle-sim"), *words]
    return subprocess.run(command, capture_output=True, text=True, env=os.environ, cwd=cwd)


@pytest.mark.slow(10)
def test_an_installed_plugin_is_recorded_by_its_name_and_by_its_modes(installed, tmp_path):
    normal = oracle_sim("record", "--testbed", "cart", "--out", "data", cwd=tmp_path)
    assert normal.returncode == 0, normal.stderr
    attacked = oracle_sim("record", "-m", "cart_offset", "--out", "data", cwd=tmp_path)
    assert attacked.returncode == 0, attacked.stderr
    found = RunDirectory(tmp_path / "data", "cart_offset", 0).manifest()
    assert (found.label, found.onset_s, found.changes[0].start_s) == ("malicious", 20.0, 20.0)
    unknown = oracle_sim("record", "--testbed", "boat", cwd=tmp_path)
    known = ", ".join([*TESTBEDS, "cart"])
    assert f"There is no testbed 'boat'; there are {known}." in unknown.stderr
