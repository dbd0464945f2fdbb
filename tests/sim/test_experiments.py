"""Real runs of all modes: two goals of block 0, so that delayed nodes appear."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.reader import BagReader, read_ground_truth
from oracle_pipeline.bags.run_directory import RunDirectory, find_runs
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from oracle_pipeline.graphs.differences import graph_differences
from oracle_pipeline.graphs.intervals import read_intervals
from sim.experiments import record_run
from sim.fan_out import fan_out, process_pool
from sim.modes import PAIRS, modes
from sim.pairs import task_effect
from sim.recipes import Campaign, recipe_for

CAMPAIGN = Campaign(goals_per_run=2)
ONE_GOAL = Campaign(goals_per_run=1)


def record(directory):
    return record_run(recipe_for(directory.mode, directory.run, CAMPAIGN), directory)


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """The runs of block 0, by mode."""
    root = tmp_path_factory.mktemp("campaign")
    directories = [RunDirectory(root, mode, 0) for mode in modes()]
    outcomes = list(fan_out(record, directories, lambda: process_pool(2)))
    assert [outcome.error for outcome in outcomes] == [None] * len(modes())
    return {directory.mode: directory for directory in directories}


def messages(directory, topic):
    with BagReader(directory.bag) as bag:
        return [(m.stamp_ns, m.data) for m in bag.messages([topic])]


def recording_start_ns(directory):
    with BagReader(directory.bag) as bag:
        return bag.start_ns


def test_the_robot_reaches_its_goals_and_touches_nothing(runs):
    for mode in ("lidar_passthrough", "lidar_passthrough_odom", "delayed_passthrough"):
        manifest = runs[mode].manifest()
        assert manifest.outcome == "succeeded"
        assert len(manifest.goal_results) == len(manifest.goals) == 2
        assert manifest.contacts == ()


def test_the_same_recipe_gives_the_same_messages_in_another_process(runs, tmp_path):
    directory = RunDirectory(tmp_path, "fake_object", 0)
    (again,) = fan_out(record, [directory], lambda: process_pool(1))
    first, second = runs["fake_object"].manifest(), again.result
    assert second.content_hash == first.content_hash
    # Its control is not there, so nobody can say what the attack did.
    assert replace(second, measured=first.measured, task_effect=first.task_effect) == first
    for graph in sorted(directory.graphs.iterdir()):
        assert graph.read_bytes() == (runs["fake_object"].graphs / graph.name).read_bytes()


def test_the_manifest_tells_what_the_bag_holds(runs):
    for directory in runs.values():
        manifest = directory.manifest()
        with BagReader(directory.bag) as bag:
            held = {name: topic.count for name, topic in bag.topics.items()}
            read = dict.fromkeys(held, 0)
            for message in bag.messages():
                read[message.topic] += 1
        told = {name: topic.messages for name, topic in manifest.topics.items()}
        del told[GROUND_TRUTH_TOPIC]
        assert held == read == told


def test_every_message_decodes_with_a_decoder_that_is_not_rosbags(runs):
    directory = runs["delayed_fakeobject"]
    (file,) = directory.bag.glob("*.mcap")
    decoded = {}
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            assert message is not None
            decoded[channel.topic] = decoded.get(channel.topic, 0) + 1
    told = {name: topic.messages for name, topic in directory.manifest().topics.items()}
    assert decoded == {name: count for name, count in told.items() if count}


def test_hidden_topics_are_neither_in_the_bag_nor_in_a_graph(runs):
    directory = runs["fake_object"]
    hidden = {topic for topic in directory.manifest().topics if "/_" in topic}
    assert hidden == {GROUND_TRUTH_TOPIC}
    for file in directory.graphs.glob("0*.gexf"):
        assert not [v for v in read_gexf(file) if "/_" in v]


def test_there_is_a_graph_for_each_interval_and_its_edges_count_what_the_bag_holds(runs):
    for directory in runs.values():
        names = sorted(file.stem for file in directory.graphs.glob("0*.gexf"))
        seconds = directory.manifest().recording_s
        intervals = int(seconds // 10) + (seconds % 10 >= 5)
        assert names == [f"{10 * i:06d}" for i in range(intervals)]
    directory = runs["lidar_passthrough"]
    with BagReader(directory.bag) as bag:
        start_ns = bag.start_ns
        stamps = np.array([m.stamp_ns - start_ns for m in bag.messages(["/odom"])])
    graph = read_gexf(directory.graphs / "000010.gexf")
    within = (stamps >= 10e9) & (stamps < 20e9)
    published = graph.edges["node:/turtlebot3_diff_drive", "topic:/odom"]
    recorded = graph.edges["topic:/odom", "node:/rosbag2_recorder"]
    # The recording begins a moment before its first message.
    assert published["messages"] == recorded["messages"] == pytest.approx(within.sum(), abs=1)
    assert published["bytes"] == published["messages"] * 724


@pytest.mark.parametrize("mode", modes())
def test_graphs_are_as_large_as_the_thesis_reports(runs, mode):
    node = "node:/lidar_passthrough"
    for _, graph in read_intervals(runs[mode].graphs):
        assert len(graph) > 100
        assert graph.number_of_edges() > 300
        assert node in graph or modes()[mode].delayed


def test_the_full_view_is_the_graph_of_the_run_with_services_and_actions(runs):
    graphs = runs["fake_object"].graphs
    full, run = read_gexf(graphs / "full.gexf"), read_gexf(graphs / "run.gexf")
    kinds = {vertex: data["kind"] for vertex, data in full.nodes(data=True)}
    plain = [vertex for vertex, kind in kinds.items() if kind in ("node", "topic")]
    assert nx.utils.graphs_equal(full.subgraph(plain), run)
    assert list(kinds.values()).count("action") == 12
    assert 250 < list(kinds.values()).count("service") < 300  # some 270 on Humble
    spin = "action:/spin"
    assert list(full.successors(spin)) == ["node:/behavior_server"]
    assert "node:/basic_navigator" in full.predecessors(spin)
    assert full.nodes[spin]["type"] == "nav2_msgs/action/Spin"


@pytest.mark.parametrize("pair", PAIRS)
def test_graphs_of_a_pair_are_equal(runs, pair):
    control, attacked = (read_intervals(runs[mode].graphs) for mode in pair)
    assert graph_differences(control, attacked) == []


@pytest.mark.parametrize(("control", "attack"), PAIRS)
def test_a_shadow_control_is_the_passthrough_message_for_message(runs, control, attack):
    with BagReader(runs[control].bag) as right, BagReader(runs[f"{attack}_shadow"].bag) as shadow:
        assert list(right.messages()) == list(shadow.messages())


@pytest.mark.parametrize(("control", "attack"), PAIRS)
def test_what_an_attack_did_to_the_task_is_told_once_its_control_is_there(runs, control, attack):
    right, attacked = runs[control].manifest(), runs[attack].manifest()
    assert right.task_effect is None
    assert attacked.task_effect is task_effect(attacked, right)


def test_a_delayed_node_appears_30_s_after_the_first_goal(runs):
    for mode in ("delayed_passthrough", "delayed_fakeobject"):
        directory = runs[mode]
        manifest = directory.manifest()
        assert manifest.onset_s == manifest.goal_results[0].accepted_s + 30.0
        start_ns = recording_start_ns(directory)
        first_ns, _ = messages(directory, "/scan_fakeobject")[0]
        assert 0.0 <= (first_ns - start_ns) / 1e9 - manifest.onset_s < 0.3
        graph = read_gexf(directory.graphs / "000020.gexf")
        assert "node:/lidar_passthrough" not in graph
        assert "node:/lidar_passthrough" in read_gexf(directory.graphs / "000030.gexf")


def test_before_its_onset_an_attack_and_its_control_are_the_same_run(runs):
    control, attacked = runs["delayed_passthrough"], runs["delayed_fakeobject"]
    onset_ns = recording_start_ns(control) + int(control.manifest().onset_s * 1e9)
    with BagReader(control.bag) as a, BagReader(attacked.bag) as b:
        before = [
            [m for m in bag.messages() if m.stamp_ns < onset_ns and m.topic != "/tf_static"]
            for bag in (a, b)
        ]
    assert before[0] == before[1]


def test_ground_truth_tells_what_was_changed_and_only_attacks_change_anything(runs):
    changed = {
        mode: max(truth.magnitude for _, truth in read_ground_truth(directory.bag))
        for mode, directory in runs.items()
    }
    malicious = {mode for mode, magnitude in changed.items() if magnitude > 0.0}
    assert malicious == {"fake_object", "random_noise", "delayed_fakeobject"}


def test_a_finished_run_is_verified_and_not_made_again(runs):
    directory = runs["lidar_passthrough"]
    before = directory.manifest_path.stat().st_mtime_ns
    assert record(directory) == directory.manifest()
    assert directory.manifest_path.stat().st_mtime_ns == before


@pytest.fixture
def copied(runs, tmp_path):
    """A copy of a finished run, to be spoilt."""
    directory = RunDirectory(tmp_path, "lidar_passthrough", 0)
    shutil.copytree(runs["lidar_passthrough"].path, directory.path)
    return directory


def test_a_place_that_holds_another_recipes_run_is_left_alone(copied):
    recipe = recipe_for(copied.mode, 0, Campaign(seed=1, goals_per_run=2))
    before = copied.manifest()
    with pytest.raises(OracleError, match="another recipe .*refresh it, or choose another root"):
        record_run(recipe, copied)
    assert copied.manifest() == before


def test_a_damaged_run_is_named_and_can_be_made_again(copied):
    (file,) = copied.bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-1000])
    with pytest.raises(OracleError, match="is damaged.*refresh it to make it again"):
        record(copied)
    recipe = recipe_for(copied.mode, 0, CAMPAIGN)
    assert record_run(recipe, copied, refresh=True).content_hash == copied.manifest().content_hash
    record(copied)


def oracle_sim(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-c", "from sim.cli import main; main()", *arguments],
        capture_output=True, text=True, check=False, **options,
    )  # fmt: skip


def test_a_run_that_was_killed_leaves_nothing_that_looks_finished_and_is_made_by_the_next_call(
    tmp_path,
):
    call = [
        sys.executable, "-c",
        "from pathlib import Path\n"
        "from oracle_pipeline.bags.run_directory import RunDirectory\n"
        "from sim.experiments import record_run\n"
        "from sim.recipes import Campaign, recipe_for\n"
        "recipe = recipe_for('lidar_passthrough', 0, Campaign(goals_per_run=8))\n"
        f"record_run(recipe, RunDirectory(Path({str(tmp_path)!r}), 'lidar_passthrough', 0))",
    ]  # fmt: skip
    process = subprocess.Popen(call)
    scratch = tmp_path / "runs" / "lidar_passthrough"
    while not list(scratch.glob(".run000.*/bag*/*")):
        assert process.poll() is None
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert find_runs(tmp_path) == []
    assert not (scratch / "run000").exists()
    directory = RunDirectory(tmp_path, "lidar_passthrough", 0)
    record_run(recipe_for("lidar_passthrough", 0, ONE_GOAL), directory)
    assert [path.name for path in scratch.iterdir()] == ["run000"]


def test_sqlite_bags_hold_the_same_messages(tmp_path):
    made = {}
    for storage in ("mcap", "sqlite3"):
        directory = RunDirectory(tmp_path / storage, "random_noise", 0)
        campaign = replace(ONE_GOAL, storage=storage)
        made[storage] = record_run(recipe_for("random_noise", 0, campaign), directory)
        assert [
            file.suffix for file in directory.bag.iterdir() if file.name != "metadata.yaml"
        ] == [{"mcap": ".mcap", "sqlite3": ".db3"}[storage]]
    assert made["mcap"].content_hash == made["sqlite3"].content_hash


def test_the_command_records_says_what_it_did_and_does_it_once(tmp_path):
    arguments = ("record", "-m", "fake_object", "-n", "1", "--goals", "1", "--out", str(tmp_path))
    first = oracle_sim(*arguments)
    assert first.returncode == 0, first.stderr
    assert "run000: succeeded, 1 of 1 goals" in first.stdout
    assert first.stderr == ""  # no progress bar where nobody looks
    started = time.monotonic()
    second = oracle_sim(*arguments)
    assert second.stdout == first.stdout
    assert time.monotonic() - started < 30.0
    assert json.loads((tmp_path / "runs/fake_object/run000/manifest.json").read_text())


def test_an_unknown_mode_is_refused_with_those_that_there_are(tmp_path):
    result = oracle_sim("record", "-m", "fake", "--out", str(tmp_path))
    assert result.returncode == 2
    assert "'fake' is not one of 'lidar_passthrough'" in result.stderr


def test_a_root_that_cannot_be_written_to_is_named(tmp_path):
    occupied = tmp_path / "occupied"
    occupied.write_text("a file")
    result = oracle_sim(
        "record", "-m", "fake_object", "--goals", "1", "--out", str(occupied / "below")
    )
    assert result.returncode == 1
    assert str(occupied) in result.stderr
    assert "Traceback" not in result.stderr


def test_a_full_disk_fails_the_run_clearly_and_keeps_what_was_finished(runs, tmp_path):
    done = RunDirectory(tmp_path, "lidar_passthrough", 0)
    shutil.copytree(runs["lidar_passthrough"].path, done.path)

    def no_file_over_a_megabyte():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))

    result = oracle_sim(
        "record", "-m", "lidar_passthrough", "-n", "2", "--goals", "2", "--workers", "1",
        "--out", str(tmp_path), preexec_fn=no_file_over_a_megabyte,
    )  # fmt: skip
    assert result.returncode == 1
    assert "lidar_passthrough|run001" in result.stderr
    assert "check free space" in result.stderr
    assert "Traceback" not in result.stderr
    assert [run.run for run in find_runs(tmp_path)] == [0]
