"""Real runs of the TurtleBot3's modes: a goal of block 0; two, so that delayed nodes appear."""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bags.reader import BagReader, read_ground_truth
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from oracle_pipeline.graphs.differences import graph_differences
from oracle_pipeline.graphs.intervals import read_intervals
from sim.campaigns import Campaign
from sim.commands.main import main
from sim.experiments import recipe_for, record_run
from sim.fan_out import fan_out, process_pool
from sim.fuzzing.compilation import compile_document, compile_scenario
from sim.fuzzing.offline import mutate_bag
from sim.fuzzing.scenario import parse_scenarios
from sim.middleware.geometry import Pose2D, quaternion_yaw
from sim.middleware.stamps import stamp_ns
from sim.modes import find_mode, modes
from sim.pairs import judge_pair, task_effect
from sim.testbeds import which_testbed
from sim.turtlebot3.frames import BASE_SCAN, BASE_SCAN_TOM
from sim.turtlebot3.recipes import TurtleBot3Recipe
from tests.recorded_runs import ONE_GOAL, linked

pytestmark = pytest.mark.slow

TURTLEBOT3 = {
    name: mode for name, mode in modes().items() if which_testbed(mode.scenario) == "turtlebot3"
}
TWO_GOALS = Campaign(goals_per_run=2)


def campaign_of(mode):
    return TWO_GOALS if mode.startswith("delayed") else ONE_GOAL


def recipe_of(mode):
    return recipe_for(mode, 0, campaign_of(mode))


def record(directory):
    return record_run(recipe_of(directory.mode), directory)


@pytest.fixture(scope="session")
def runs(recorded_run, tmp_path_factory):
    """The runs of block 0 below one root, by mode."""
    root = tmp_path_factory.mktemp("campaign")
    runs = {mode: linked(recorded_run(mode, 0, campaign_of(mode)), root) for mode in TURTLEBOT3}
    for directory in runs.values():
        judge_pair(directory)
    return runs


def messages(directory, topic):
    with BagReader(directory.bag) as bag:
        return [(m.stamp_ns, m.data) for m in bag.messages([topic])]


def recording_start_ns(directory):
    with BagReader(directory.bag) as bag:
        return bag.start_ns


def test_the_robot_reaches_its_goals_and_touches_nothing(runs):
    for mode in TURTLEBOT3.values():
        if mode.label != "normal":
            continue
        manifest = runs[mode.id].manifest()
        assert manifest.outcome == "succeeded"
        goals = campaign_of(mode.id).goals_per_run
        assert len(manifest.goal_results) == len(manifest.goals) == goals
        assert manifest.contacts == ()


def test_the_same_recipe_gives_the_same_messages_in_another_process(runs, tmp_path):
    control = next(control for control, attack in PAIRS if attack == "fake_object")
    linked(runs[control], tmp_path)  # so that the task effect is known
    directory = RunDirectory(tmp_path, "fake_object", 0)
    (again,) = fan_out(record, [directory], lambda: process_pool(1))
    first, second = runs["fake_object"].manifest(), again.result
    assert second.content_hash == first.content_hash
    assert first.task_effect is not None
    assert replace(second, measured=first.measured) == first
    for graph in sorted(directory.graphs.iterdir()):
        assert graph.read_bytes() == (runs["fake_object"].graphs / graph.name).read_bytes()


def test_the_manifest_counts_the_messages_of_the_bag(runs):
    for directory in runs.values():
        manifest = directory.manifest()
        with BagReader(directory.bag) as bag:
            held = {name: topic.count for name, topic in bag.topics.items()}
            read = dict.fromkeys(held, 0)
            for message in bag.messages():
                read[message.topic] += 1
        counts = {name: topic.messages for name, topic in manifest.topics.items()}
        del counts[GROUND_TRUTH_TOPIC]
        assert held == read == counts


def test_every_message_decodes_with_a_decoder_that_is_not_rosbags(runs):
    directory = runs["random_noise"]
    (file,) = directory.bag.glob("*.mcap")
    decoded = {}
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            assert message is not None
            decoded[channel.topic] = decoded.get(channel.topic, 0) + 1
    counts = {name: topic.messages for name, topic in directory.manifest().topics.items()}
    assert decoded == {name: count for name, count in counts.items() if count}


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


@pytest.mark.parametrize("mode", TURTLEBOT3)
def test_graphs_are_as_large_as_the_thesis_reports(runs, mode):
    node = "node:/lidar_passthrough"
    for _, graph in read_intervals(runs[mode].graphs):
        assert len(graph) > 100
        assert graph.number_of_edges() > 300
        assert node in graph or mode.startswith("delayed")


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
def test_the_task_effect_is_known_once_the_control_exists(runs, control, attack):
    right, attacked = runs[control].manifest(), runs[attack].manifest()
    assert right.task_effect is None
    assert attacked.task_effect == task_effect(attacked, right)


def test_a_delayed_node_appears_when_its_block_has_drawn_after_the_first_goal(runs):
    onsets = set()
    for mode in ("delayed_passthrough", "delayed_fakeobject"):
        directory = runs[mode]
        manifest = directory.manifest()
        onsets.add(manifest.onset_s)
        assert 25.0 <= manifest.onset_s - manifest.goal_results[0].accepted_s <= 35.0
        start_ns = recording_start_ns(directory)
        first_ns, _ = messages(directory, "/scan_fakeobject")[0]
        assert 0.0 <= (first_ns - start_ns) / 1e9 - manifest.onset_s < 0.3
        interval = int(manifest.onset_s // 10) * 10
        before = read_gexf(directory.graphs / f"{interval - 10:06}.gexf")
        assert "node:/lidar_passthrough" not in before
        after = read_gexf(directory.graphs / f"{interval:06}.gexf")
        assert "node:/lidar_passthrough" in after
    assert len(onsets) == 1, "a mode and its control have the same onset"


def test_before_its_onset_an_attack_and_its_control_are_the_same_run(runs):
    control, attacked = runs["delayed_passthrough"], runs["delayed_fakeobject"]
    onset_ns = recording_start_ns(control) + int(control.manifest().onset_s * 1e9)
    with BagReader(control.bag) as a, BagReader(attacked.bag) as b:
        before = [
            [m for m in bag.messages() if m.stamp_ns < onset_ns and m.topic != "/tf_static"]
            for bag in (a, b)
        ]
    assert before[0] == before[1]


def test_ground_truth_has_the_changes_and_only_attacks_have_any(runs):
    touching = {"benign_median", "benign_noise", "benign_drop"}
    for mode, directory in runs.items():
        manifest, start_ns = directory.manifest(), recording_start_ns(directory)
        truth = read_ground_truth(directory.bag)
        changed = [(ns - start_ns) / 1e9 for ns, message in truth if message.magnitude > 0.0]
        assert bool(changed) == (manifest.label == "malicious" or mode in touching)
        # The recording begins a moment before its first message.
        assert sum(change.messages for change in manifest.changes) == len(changed)
        bins = {change.start_s for change in manifest.changes}
        assert bins == {5.0 * (second // 5) for second in changed}


@pytest.mark.parametrize(
    "mode", ["fake_object", "random_noise", "delayed_fakeobject", "benign_drop"]
)
def test_a_runs_own_attack_over_its_bag_gives_what_the_node_published(runs, mode, tmp_path):
    directory = runs[mode]
    recipe = TurtleBot3Recipe.from_dict(directory.manifest().recipe)
    program = compile_document(recipe.mode, recipe.scenario)
    bag, mutant = directory.bag, tmp_path / "mutant"
    done = CliRunner().invoke(
        main, ["mutate", str(bag), str(mutant), "--like", str(directory.path)]
    )
    assert done.exit_code == 0, done.output
    online, offline = (by_stamp(path, program.output_topic) for path in (bag, mutant))
    both = online.keys() & offline.keys()
    assert len(both) > 100
    assert {stamp: online[stamp] for stamp in both} == {stamp: offline[stamp] for stamp in both}
    # One may have been under way at the beginning, and at the end.
    assert len(online.keys() ^ offline.keys()) <= 2


def test_a_bag_shows_when_each_goal_was_accepted(runs, tmp_path):
    directory = runs["delayed_passthrough"]
    text = """\
schema: mutant/v1
id: between_goals
label: malicious
main: {type: sensor_msgs/msg/LaserScan, input: /scan_tom, output: /scan_fakeobject}
activation: {onset: {after: goal_accepted, goal: GOAL}UNTIL}
transform: {actions: [{name: up, do: [{add: {field: ranges, by: 1.0}}]}]}
"""
    first, second = (goal.accepted_s for goal in directory.manifest().goal_results)
    for goal, until, begin, end in ((1, ", until_goal: 2", first, second), (2, "", second, 1e9)):
        (scenario,) = parse_scenarios(
            text.replace("GOAL", str(goal)).replace("UNTIL", until).encode(), "goals.yaml"
        )
        summary = mutate_bag(directory.bag, tmp_path / f"goal{goal}", compile_scenario(scenario), 1)
        assert summary.onset_s == pytest.approx(begin, abs=0.3)
        acted = [change.start_s for change in summary.changes]
        assert begin - 5.0 < acted[0] <= begin + 0.3
        assert acted[-1] <= end + 0.3
        assert len(acted) >= 2


def by_stamp(bag, topic):
    with BagReader(bag) as reader:
        return {
            stamp_ns(reader.deserialize(message).header.stamp): message.data
            for message in reader.messages([topic])
        }


def test_the_manifest_has_the_attack_with_its_parameters(runs):
    attack = runs["delayed_fakeobject"].manifest().attack
    assert attack.keys() == {"frame", "x", "y", "radius"}
    assert runs["random_noise"].manifest().attack == {"level": 0.1}
    assert runs["lidar_passthrough"].manifest().attack == {}
    for directory in runs.values():
        manifest = directory.manifest()
        assert manifest.attack_seed == TurtleBot3Recipe.from_dict(manifest.recipe).attack_seed()
    assert len({directory.manifest().scenario_hash for directory in runs.values()}) == len(runs)


def returns_from_object(directory, topic):
    """How far from the axis of the block's object its nearest returns are, in units of its radius.

    ``/odom`` is exact: its frame is the world.
    """
    recipe = TurtleBot3Recipe.from_dict(directory.manifest().recipe)
    values = recipe_of("fake_object").parameters
    mount = {"/scan": BASE_SCAN, "/scan_fakeobject": BASE_SCAN_TOM}[topic]
    robot, ratios = None, [np.empty(0)]
    with BagReader(directory.bag) as bag:
        for raw in bag.messages([topic, "/odom"]):
            message = bag.deserialize(raw)
            if raw.topic == "/odom":
                position, q = message.pose.pose.position, message.pose.pose.orientation
                robot = Pose2D(position.x, position.y, quaternion_yaw(q.x, q.y, q.z, q.w))
            elif robot is not None:
                sensor = robot.compose(Pose2D(*mount.xyz[:2]))
                bearings = message.angle_min + message.angle_increment * np.arange(360)
                ends = message.ranges[:, None] * np.column_stack(
                    [np.cos(bearings), np.sin(bearings)]
                )
                away = np.hypot(*(sensor.apply(ends) - (values["x"], values["y"])).T)
                ratios.append(away / recipe.fake_object.radius)
    found = np.concatenate(ratios)
    return found[found < 1.3]


def test_a_real_obstacle_is_where_the_fake_one_would_be_and_all_lidars_see_it(runs):
    real, obstacle = runs["benign_obstacle"], pytest.approx(1.0, abs=0.1)
    assert np.median(returns_from_object(real, "/scan")) == obstacle
    assert np.median(returns_from_object(real, "/scan_fakeobject")) == obstacle
    fake = runs["fake_object"]
    assert np.median(returns_from_object(fake, "/scan_fakeobject")) == obstacle
    assert len(returns_from_object(fake, "/scan")) == 0
    assert real.manifest().contacts == ()


def test_a_slow_robot_keeps_to_its_speed_and_takes_longer(runs):
    slow, usual = (runs[mode].manifest() for mode in ("benign_slow", "lidar_passthrough"))
    assert slow.recording_s > 1.2 * usual.recording_s
    with BagReader(runs["benign_slow"].bag) as bag:
        sent = [bag.deserialize(message) for message in bag.messages(["/cmd_vel"])]
    assert max(abs(command.linear.x) for command in sent) <= 0.6 * 0.26 + 1e-9
    assert max(abs(command.angular.z) for command in sent) <= 0.6 + 1e-9


def test_held_before_an_obstacle_navigation_gives_up_after_all_its_recoveries(tmp_path):
    directory = RunDirectory(tmp_path, "held_object", 0)
    mode = find_mode("held_object")
    manifest = record_run(recipe_for(mode, 0, ONE_GOAL), directory)
    (goal,) = manifest.goal_results
    assert manifest.outcome == goal.outcome == "aborted"
    assert 150.0 <= goal.ended_s - goal.accepted_s <= 170.0
    assert goal.recoveries > 6
