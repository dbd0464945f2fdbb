import math

import numpy as np
import pytest

from oracle_pipeline.bags.manifest import Pose
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.replay.story import run_scene
from oracle_pipeline.reporting.stored_report import ReportError
from tests.oracle_pipeline.features.conftest import drive, write_bag
from tests.oracle_pipeline.reporting.recordings import (
    COSTMAP,
    MAP,
    MAP_TO_ODOM,
    MOUNT,
    QUARTER,
    at,
    ended,
    manifest,
    planned,
    scanned,
    seen,
    standing,
    tf,
    ticked,
)


def scene_of_run(path, moments_per_s=None):
    with open_run(path) as run:
        return run_scene(run, moments_per_s)


def test_the_path_is_odometry_in_the_map_frame(recorded):
    scene = scene_of_run(recorded(MAP, at(9.0, 9.0), MAP_TO_ODOM, at(0.0, 0.0), at(2.0, 0.0)))
    assert scene.path == pytest.approx(np.array([[10.0, 0.0], [10.0, 2.0]]))
    assert scene.map.cells.tolist() == [[-1, 0, 100], [0, 0, 0]]
    assert (scene.map.resolution_m, scene.map.origin) == (0.5, (-1.0, -2.0, 0.0))
    assert (scene.start, scene.goals.tolist()) == ((10.0, 0.0), [[10.0, 2.0, 0.0]])
    assert (scene.frame, scene.title) == ("map", "fake_object|run003, succeeded")


def test_topics_are_found_by_role(tmp_path):
    usual = [each for each in drive() if each[1] in ("/odom", "/scan", "/plan")]
    names = {"/odom": "/robot1/wheels/track", "/scan": "/robot1/front", "/plan": "/robot1/way"}
    write_bag(tmp_path / "usual", usual)
    write_bag(tmp_path / "renamed", [(t, names[topic], m) for t, topic, m in usual])
    one, other = (scene_of_run(tmp_path / name, 1.0) for name in ("usual", "renamed"))
    assert len(one.path) > 10
    np.testing.assert_array_equal(one.path, other.path)
    for mine, its in zip(one.moments, other.moments, strict=True):
        np.testing.assert_array_equal(mine.plan, its.plan)
        np.testing.assert_array_equal(mine.scan, its.scan)


def test_a_standing_robot_adds_no_points_to_its_path(recorded):
    scene = scene_of_run(recorded(MAP_TO_ODOM, at(0.0, 0.0), at(0.001, 0.0), at(0.0, 0.002)))
    assert len(scene.path) == 1


def test_the_fake_object_and_the_nearest_scan_are_on_the_map(recorded):
    far, near = (at(-3.0, 0.0), seen(1.0, 1.0)), (at(0.0, 0.0), seen(0.3, math.inf, 2.0))
    scene = scene_of_run(recorded(MAP, MAP_TO_ODOM, MOUNT, *far, *near, *far))
    assert scene.disc == pytest.approx((10.0, 1.0, 0.2))
    assert scene.scan == pytest.approx(np.array([[10.0, 0.8], [10.0, -1.5]]), abs=1e-6)


def test_without_an_object_the_scan_is_from_the_middle_of_the_run(recorded):
    drive = [part for x in range(5) for part in (at(float(x), 0.0), seen(1.0))]
    run = recorded(MAP, MAP_TO_ODOM, MOUNT, *drive, manifest_=manifest(attack={"level": 0.1}))
    scene = scene_of_run(run)
    assert scene.disc is None
    assert scene.scan == pytest.approx(np.array([[10.0, 2.5]]), abs=1e-6)  # driven 1, mounted 0.5


def test_rays_without_a_return_give_no_points(recorded):
    beyond = scanned(0.05, 1.0, 4.0, math.nan)
    (*_, last) = scene_of_run(recorded(MAP_TO_ODOM, at(0.0, 0.0), beyond), 10.0).moments
    assert last.scan == pytest.approx(np.array([[9.0, 0.0]]), abs=1e-6)


def test_a_normal_run_has_no_attack_in_its_scene(recorded):
    right = manifest("normal", {}, onset_s=0.0)
    scene = scene_of_run(
        recorded(MAP, MAP_TO_ODOM, MOUNT, at(0.0, 0.0), seen(1.0), manifest_=right), 10.0
    )
    assert scene.disc is scene.scan is scene.onset_s is None
    assert not any(len(moment.attacked) for moment in scene.moments)


def test_a_moment_has_the_newest_data_at_its_time(recorded):
    drive = [MAP_TO_ODOM, at(0.0, 0.0), scanned(1.0), at(1.0, 0.0, QUARTER), scanned(2.0)]
    scene = scene_of_run(
        recorded(*drive, planned((3.0, 4.0), (5.0, 6.0)), COSTMAP, at(2.0, 0.0)), 10.0
    )
    assert [m.time_s for m in scene.moments] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
    assert [m.driven for m in scene.moments] == [1, 1, 2, 2, 2, 2, 3]
    first, second, _, third, fourth, _, last = scene.moments
    assert first.robot == pytest.approx((10.0, 0.0, QUARTER))
    assert len(first.scan) == len(first.plan) == 0
    assert second.scan == pytest.approx(np.array([[10.0, 1.0]]), abs=1e-6)
    assert third.robot == pytest.approx((10.0, 1.0, 2 * QUARTER))
    assert third.scan == pytest.approx(np.array([[8.0, 1.0]]), abs=1e-6)
    assert (third.plan.tolist(), third.costmap) == ([], None)
    assert fourth.plan.tolist() == [[3.0, 4.0], [5.0, 6.0]]
    assert last.costmap.origin == pytest.approx((11.0, -1.0, QUARTER))
    assert last.costmap.cells.tolist() == [[0, 99], [100, -1]]


def test_the_fake_object_is_shown_from_the_onset(recorded):
    drive = [at(x / 10, 0.0) for x in range(6)]
    scene = scene_of_run(recorded(MAP_TO_ODOM, *drive, manifest_=manifest(onset_s=0.35)), 10.0)
    assert [m.time_s for m in scene.moments if m.disc] == pytest.approx([0.4, 0.5, 0.6])


def test_recoveries_are_counted_when_they_begin(recorded):
    begun = ticked("RecoveryActions", "IDLE", "RUNNING")
    over = ticked("RecoveryActions", "RUNNING", "SUCCESS")
    other = ticked("FollowPath", "IDLE", "RUNNING")
    run = recorded(MAP_TO_ODOM, at(0.0, 0.0), other, begun, over, begun, at(1.0, 0.0))
    (*_, last) = scene_of_run(run, 10.0).moments
    assert last.recoveries == 2


def test_goals_are_active_reached_or_missed(recorded):
    results = (ended(0.1, 0.3), ended(0.3, None, "timeout"))
    goals = (Pose(1.0, 0.0, 0.0),) * 3
    run = recorded(MAP_TO_ODOM, at(0.0, 0.0), manifest_=manifest(goals=goals, goal_results=results))
    scene = scene_of_run(run)
    assert [scene.goal_at(t) for t in (0.0, 0.1, 0.2, 0.3, 9.0)] == [None, 0, 0, 1, 1]
    assert [scene.reached(t).tolist() for t in (0.2, 0.3)] == [[False] * 3, [True, False, False]]
    assert scene.reached().tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("messages", "lacking"),
    [
        ([MAP, at(0.0, 0.0)], "no transform from map to odom"),
        ([MAP, MAP_TO_ODOM], "neither odometry nor a transform to base_footprint or base_link"),
        ([MOUNT, MAP_TO_ODOM], "neither odometry"),
    ],
)
def test_the_error_for_an_incomplete_bag_names_the_missing_part(recorded, messages, lacking):
    with pytest.raises(ReportError, match=lacking):
        scene_of_run(recorded(*messages))


def test_a_cycle_of_frames_has_no_root(recorded):
    ring = ("/tf", "tf2_msgs/msg/TFMessage", tf("base_footprint", "odom", 0.0, 0.0, 0.0))
    with pytest.raises(ReportError, match="transform"):
        scene_of_run(recorded(MAP, ring, at(0.0, 0.0)))


def test_a_foreign_bag_is_drawn_in_odom_without_localisation(recorded):
    scene = scene_of_run(recorded(at(1.0, 0.0), scanned(1.0), at(2.0, 0.0)) / "bag", 10.0)
    assert (scene.frame, scene.title, scene.map) == ("odom", "bag", None)
    assert scene.path.tolist() == [[1.0, 0.0], [2.0, 0.0]]
    assert scene.start == (1.0, 0.0)
    assert len(scene.goals) == 0
    assert np.unique(scene.surroundings(), axis=0) == pytest.approx(np.array([[2.0, 0.0]]))


def test_without_odometry_the_path_comes_from_transforms(recorded):
    scene = scene_of_run(recorded(MAP_TO_ODOM, standing(0.0, 0.0), standing(2.0, 0.0)) / "bag")
    assert scene.path == pytest.approx(np.array([[10.0, 0.0], [10.0, 2.0]]))
