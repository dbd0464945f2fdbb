"""Options of a launch and a recording, each on a real run of one goal."""

from dataclasses import replace

import numpy as np
import pytest

from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.reader import BagReader
from sim.campaigns import Options, RecipeError
from sim.experiments import recipe_for
from sim.recording import DEBUG_TOPICS, ReceiveClock
from sim.turtlebot3.recipes import TurtleBot3Recipe
from tests.recorded_runs import ONE_GOAL

pytestmark = pytest.mark.slow

MONITOR, RELAY = "node:/collision_monitor", "node:/lidar_passthrough"


@pytest.fixture
def record(recorded_run):
    def record(*, timeout_s=6.0, **options):
        campaign = replace(ONE_GOAL, options=Options(**options), timeout_s=timeout_s)
        return recorded_run("lidar_passthrough", 0, campaign)

    return record


def counts(directory):
    with BagReader(directory.bag) as bag:
        return {name: topic.count for name, topic in bag.topics.items()}


def test_by_default_neither_debug_nor_hidden_topics_are_in_the_bag_and_cameras_are_silent(record):
    held = counts(record())
    assert not set(DEBUG_TOPICS) & set(held)
    assert not [topic for topic in held if "/_" in topic]
    assert held["/intel_realsense_r200_depth/points"] == 0


def test_hidden_topics_are_feedback_and_status_of_every_action(record):
    held = counts(record(hidden_topics=True))
    hidden = {topic for topic in held if "/_" in topic}
    assert len(hidden) == 24  # of 12 actions
    assert held["/navigate_to_pose/_action/feedback"] > 0
    assert held["/navigate_to_pose/_action/status"] > 0


def test_receive_stamps_are_later_than_what_they_stamp_by_the_way_through_the_recorder(record):
    by_clock, by_time = record(timeout_s=20.0, receive_stamps=True), record(timeout_s=20.0)
    stamped = []
    for directory in (by_clock, by_time):
        with BagReader(directory.bag) as bag:
            stamped.append([(m.topic, m.data, m.stamp_ns) for m in bag.messages(["/odom", "/imu"])])
    clock, time = (np.array([stamp for *_, stamp in run]) for run in stamped)
    assert [run[:2] for run in stamped[0]] == [run[:2] for run in stamped[1]]
    assert np.all(np.diff(clock) >= 0)
    assert clock[0] >= ReceiveClock.EPOCH_NS
    late = (clock - ReceiveClock.EPOCH_NS) - (time - time[0])
    assert np.median(late - late.min()) == pytest.approx(0.3e6, rel=0.5)


def test_the_wiring_decides_the_sources_of_the_collision_monitor(record):
    heard = {}
    for wiring in ("additive", "replace", "absent"):
        directory = record(timeout_s=10.0, wiring=wiring)
        graph = read_gexf(directory.graphs / "000000.gexf")
        sources = ("topic:/scan_tom", "topic:/scan_fakeobject")
        heard[wiring] = [graph.has_edge(topic, MONITOR) for topic in sources]
        assert (RELAY in graph) is (wiring != "absent")
    assert heard == {
        "additive": [True, True], "replace": [False, True], "absent": [True, True]
    }  # fmt: skip


def test_an_attack_without_its_node_is_refused():
    campaign = replace(ONE_GOAL, options=Options(wiring="absent"))
    with pytest.raises(RecipeError, match="no attack"):
        recipe_for("fake_object", 0, campaign)


def test_with_wheel_odometry_the_robot_starts_at_zero_and_finds_its_goal(record):
    directory = record(timeout_s=600.0, odometry_source="encoder")
    assert directory.manifest().outcome == "succeeded"
    with BagReader(directory.bag) as bag:
        first = bag.deserialize(next(iter(bag.messages(["/odom"])))).pose.pose.position
    assert (first.x, first.y) == pytest.approx((0.0, 0.0), abs=0.05)


def test_parameters_of_nav2_are_in_the_recipe_only_if_set_and_change_the_run(record):
    name = "local_costmap.inflation_layer.inflation_radius"
    usual, wide = record(), record(nav2_params={name: 0.3})
    assert "nav2_params" not in usual.manifest().recipe["options"]
    assert wide.manifest().recipe["options"]["nav2_params"] == {name: 0.3}
    assert TurtleBot3Recipe.from_dict(wide.manifest().recipe).options.nav2_params == {name: 0.3}
    assert usual.manifest().content_hash != wide.manifest().content_hash


def test_a_recipe_has_a_relation_only_if_it_is_not_the_default(record):
    usual, mirrored = record(), record(relation="mirrored")
    assert "relation" not in usual.manifest().recipe["options"]
    assert mirrored.manifest().recipe["options"]["relation"] == "mirrored"
    assert mirrored.manifest().world == f"{usual.manifest().world}-mirrored"
    assert TurtleBot3Recipe.from_dict(mirrored.manifest().recipe).options.relation == "mirrored"


def test_a_recipe_with_options_survives_its_manifest(record):
    directory = record(wiring="replace", receive_stamps=True)
    recipe = TurtleBot3Recipe.from_dict(directory.manifest().recipe)
    assert recipe.options == Options(wiring="replace", receive_stamps=True)


@pytest.mark.parametrize("withdrawn", ["debug_topics", "cameras"])
def test_a_recipe_of_an_earlier_release_is_valid_unless_it_has_a_withdrawn_option(withdrawn):
    recipe = recipe_for("lidar_passthrough", 0, ONE_GOAL)
    document = recipe.to_dict()
    assert type(recipe).from_dict(document) == recipe
    with pytest.raises(TypeError, match=withdrawn):
        type(recipe).from_dict({**document, "options": {withdrawn: True}})
