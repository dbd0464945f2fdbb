import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import message_class
from oracle_pipeline.features.engine.plugin import Series, Window
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.lidar import local_costmap
from oracle_pipeline.features.lidar.map_consistency import MapGrid
from oracle_pipeline.features.motion import localisation, velocity
from oracle_pipeline.features.navigation import progress
from oracle_pipeline.features.navigation.goals import Goal
from oracle_pipeline.features.statistics.reduction import largest, mean, quantile, within
from tests.oracle_pipeline.features.scenery import (
    believed_message,
    extract,
    grid_message,
    header,
    odometry_message,
    pose_message,
)

ROOT = "NavigateRecovery"


@pytest.fixture
def extracted(tmp_path_factory):
    """Return a function from plugins and messages to values, places and what is missing."""
    return lambda module, recorded: extract(
        module.register_features(), recorded, tmp_path_factory.mktemp("bag")
    )


def series(*pairs):
    times, values = zip(*pairs, strict=True)
    return Series(np.array(times, dtype=float), np.array(values, dtype=float))


def span(start_s, end_s):
    return Window(start_s, end_s, graph=None, system=None, intervals=(), arrivals={})


def twist(speed, turn):
    vector = message_class("geometry_msgs/msg/Vector3")
    return message_class("geometry_msgs/msg/Twist")(vector(speed, 0.0, 0.0), vector(0.0, 0.0, turn))


numbers = st.lists(st.floats(-10, 10) | st.just(np.nan), min_size=1, max_size=12)


@given(numbers, st.floats(0, 1))
def test_quantiles_are_those_of_numpy(values, q):
    ours = quantile(Series(np.arange(len(values), dtype=float), np.array(values)), span(0, 99), q)
    finite = [value for value in values if not np.isnan(value)]
    assert ours == pytest.approx(np.quantile(finite, q) if finite else np.nan, nan_ok=True)


def test_a_window_has_its_start_and_not_its_end():
    times = np.array([0.0, 1.0, 2.0, 3.0])
    assert times[within(times, span(1, 3))].tolist() == [1.0, 2.0]
    assert np.isnan(mean(Series(times, times), span(5, 6)))
    assert largest({"a": 1.0, "b": np.nan, "c": 2.0}, "").where == "c"
    assert largest({"b": np.nan}, "nothing").reason == "nothing"


def test_the_share_that_the_monitor_passed_is_known_by_command():
    asked = series((0.0, (0.2, 0.0)), (1.0, (0.2, 0.1)), (2.0, (0.0, 0.0)), (3.0, (0.2, 0.0)),
                   (4.0, (0.2, 0.0)))  # fmt: skip
    answers = series((0.01, (0.2, 0.0)), (1.01, (0.06, 0.03)), (2.01, (0.0, 0.0)), (3.01, (0, 0)))
    share, altered = velocity.answers_of(asked, answers)
    assert share.times_s.tolist() == [0.0, 1.0, 3.0, 4.0]
    assert share.values == pytest.approx([1.0, 0.3, 0.0, 0.0])  # the last got no answer
    assert not altered.values.any()


@pytest.mark.parametrize("sent", [(0.2, 0.3), (0.22, 0.0), (-0.1, 0.0)])
def test_an_output_that_is_no_fraction_of_the_command_is_altered(sent):
    asked, answers = series((0.0, (0.2, 0.0))), series((0.01, sent))
    assert velocity.answers_of(asked, answers).altered.values.tolist() == [1.0]


def test_stops_and_slowdowns_of_the_collision_monitor(extracted):
    asked = [(t / 10, "/cmd_vel_raw", twist(0.2, 0.0)) for t in range(100)]
    sent = [
        (t / 10 + 0.01, "/cmd_vel", twist(0.0 if t < 20 else 0.06 if t < 50 else 0.2, 0.0))
        for t in range(100)
    ]
    values, *_ = extracted(velocity, sorted(asked + sent, key=lambda each: each[0]))
    assert values["monitor_stopped"] == pytest.approx(0.2)
    assert values["monitor_slowed"] == pytest.approx(0.3)
    assert values["command_zero"] == pytest.approx(0.2)


def test_commands_have_the_same_jerk_whatever_the_recorder_does_to_their_times(extracted):
    found = []
    for grid_s in (1e-6, 0.02):
        sent = [
            (float(np.ceil(t * 0.055 / grid_s) * grid_s), "/cmd_vel", twist(0.1 * (t % 2), 0.0))
            for t in range(100)
        ]
        found.append(extracted(velocity, sent)[0]["command_jerk"])
    assert found[0] == pytest.approx(found[1], rel=0.02)


def test_commands_without_a_monitor(extracted):
    # The turn goes +1, -1, +1, ... a command each 0.1 s: 9 reversals within a second.
    sent = [(t / 10, "/cmd_vel", twist(0.0, (-1.0) ** t)) for t in range(10)]
    values, _, missing = extracted(velocity, sent)
    assert "requested_command" in missing["monitor_stopped"]
    assert values["command_reversals"] == pytest.approx(9 * 60.0)
    assert values["command_angular_jerk"] == pytest.approx(4.0 / 0.1**2)
    assert values["command_jerk"] == values["command_zero"] == 0.0


def test_zeros_are_no_reversal():
    assert velocity.reversals(np.array([1.0, 0.0, 1.0, 0.0, -1.0, 0.0, -1.0])) == 1


def test_recoveries_and_clearings_are_counted_as_they_begin(extracted, messages):
    recorded = [
        (0.0, "/behavior_tree_log", messages.tree_log(0, (ROOT, "IDLE", "RUNNING"))),
        (10.0, "/behavior_tree_log", messages.tree_log(
            10, ("ClearLocalCostmap-Context", "IDLE", "SUCCESS"), ("Spin", "IDLE", "RUNNING"),
        )),
        (12.0, "/behavior_tree_log", messages.tree_log(
            12, ("Spin", "RUNNING", "SUCCESS"), ("Spin", "SUCCESS", "IDLE"),
        )),
        (20.0, "/behavior_tree_log", messages.tree_log(20, ("BackUp", "IDLE", "RUNNING"))),
    ]  # fmt: skip
    values, *_ = extracted(progress, recorded)
    assert values["recoveries"] == pytest.approx(2 * 60.0 / 20.0)
    assert values["costmap_clearings"] == pytest.approx(60.0 / 20.0)


def test_time_belongs_to_the_goal_that_was_under_way():
    goals = [Goal(1.0, 4.0, reached=True), Goal(6.0)]
    times = np.array([0.0, 1.0, 4.0, 5.0, 6.0, 99.0])
    assert progress.goal_at(goals, times).tolist() == [-1, 0, 0, -1, 1, 1]


def test_a_robot_that_stands_or_turns_on_the_spot_stalls():
    # It drives for 10 s, then stands for 10 s; from 15 s on it was here 5 s before.
    times = np.arange(0.0, 20.01, 0.1)
    x = 0.2 * np.minimum(times, 10.0)
    driven = Series(times, np.column_stack([x, 0 * x, times, 0 * x]))
    stalled = progress.stalls([Goal(0.0)], driven)
    assert stalled.times_s[0] == pytest.approx(5.0)
    began = stalled.times_s[stalled.values == 1.0][0]
    assert began == pytest.approx(14.6, abs=0.15)  # 0.1 m before it stops
    assert stalled.values[stalled.times_s < 14.4].max() == 0.0
    assert progress.stalls([Goal(12.0)], driven).times_s[0] == pytest.approx(17.0)


@given(st.lists(st.booleans(), max_size=30))
def test_longest_run_of_flags(flags):
    text = "".join("x" if flag else " " for flag in flags)
    assert progress.longest(np.array(flags, dtype=bool)) == max(map(len, text.split()), default=0)


def test_plans_are_compared_within_a_goal_and_drives_by_their_goals(extracted, messages):
    recorded = [
        (0.0, "/behavior_tree_log", messages.tree_log(0, (ROOT, "IDLE", "RUNNING"))),
        *((t, "/plan", messages.plan(t, 4.0 - 0.2 * t)) for t in (1.0, 2.0, 3.0)),
        (4.0, "/plan", messages.plan(4, 4.4)),  # a detour: one metre longer than 3.4 m
        (10.0, "/behavior_tree_log", messages.tree_log(10, (ROOT, "RUNNING", "IDLE"))),
        (11.0, "/behavior_tree_log", messages.tree_log(11, (ROOT, "IDLE", "RUNNING"))),
        (12.0, "/plan", messages.plan(12, 9.0)),  # another goal: nothing to compare with
        *((t / 10, "/odom", odometry_message(t / 10, 0.5 * t / 10, 0.0)) for t in range(200)),
    ]
    values, *_ = extracted(progress, sorted(recorded, key=lambda each: each[0]))
    assert values["replans"] == pytest.approx(5 * 60.0 / 18.9)  # of 19.9 s, 1 s without a goal
    assert values["progress"] == pytest.approx(0.2)
    # Changes are -0.2, -0.2, +1.0 m: 95 % of the way from 0 (twice) to 1.
    assert values["plan_lengthening"] == pytest.approx(0.9)
    # The first goal: 3.8 m planned, and 10 s at 0.5 m/s driven.
    assert values["path_efficiency"] == pytest.approx(3.8 / 5.0, rel=0.02)
    assert values["stalled"] == 0.0
    # No goal from 10 s to 11 s, at 0.5 m/s.
    assert values["driven_without_goal"] == pytest.approx(0.5, abs=0.06)


def test_without_goals_there_is_no_navigation(extracted):
    recorded = [(t / 10, "/odom", odometry_message(t / 10, 0j, 0.0)) for t in range(100)]
    _, _, missing = extracted(progress, recorded)
    assert "behaviour tree" in missing["stalled"]


def test_localisation_is_compared_with_odometry(extracted):
    # Odometry drives along x at 0.5 m/s; localisation finds it 0.1 m to the left a second.
    odometry = [(t / 10, "/odom", odometry_message(t / 10, 0.05 * t + 0j, 0.0)) for t in range(90)]
    believed = [
        (float(t), "/amcl_pose", believed_message(t, 0.5 * t + 0.1j * t, 0.02 * t, 0.3, 0.1))
        for t in range(8)
    ]
    values, *_ = extracted(localisation, sorted(odometry + believed, key=lambda each: each[0]))
    assert values["position_spread"] == pytest.approx(0.3)
    assert values["yaw_spread"] == pytest.approx(0.1)
    assert values["yaw_correction"] == pytest.approx(0.02)
    assert values["position_correction"] == pytest.approx(0.1, abs=0.03)


def plan_message(seconds, places):
    poses = [
        message_class("geometry_msgs/msg/PoseStamped")(header(0.0, "map"), pose_message(place, 0.0))
        for place in places
    ]
    return message_class("nav_msgs/msg/Path")(header(seconds, "map"), poses)


@pytest.mark.parametrize("aside_m", [0.0, 0.3])
def test_a_plan_begins_at_the_estimated_pose(extracted, aside_m):
    # Localisation has the robot 2 m to the left of where odometry has it.
    odometry = [(t / 10, "/odom", odometry_message(t / 10, 0.05 * t + 0j, 0.0)) for t in range(90)]
    believed = [
        (2.0 * t, "/amcl_pose", believed_message(2 * t, 1.0 * t + 2j, 0.0, 0.3, 0.1))
        for t in range(4)
    ]
    plans = [
        (t + 0.6, "/plan", plan_message(t + 0.5, [0.5 * t + 0.25 + 2j + 1j * aside_m, 9.0 + 2j]))
        for t in range(7)
    ]
    empty = (7.6, "/plan", plan_message(7.5, []))
    recorded = sorted([*odometry, *believed, *plans, empty], key=lambda each: each[0])
    values, *_ = extracted(localisation, recorded)
    assert values["plan_offset"] == pytest.approx(aside_m, abs=1e-6)


def grid(cells, corner=0j):
    pose = PlanarPose(np.asarray(corner), np.asarray(1.0 + 0j))
    return MapGrid(pose, 0.5, np.asarray(cells, dtype=np.int8))


def test_costmaps_are_compared_where_they_overlap():
    before = grid([[0, 0, 100], [0, 0, 0]])
    moved = grid([[0, 100, 0], [0, 0, 100]], 0.5 + 0j)  # one column on; the same cell is lethal
    assert local_costmap.changes(before, moved) == (0, 0)  # the last column was not there before
    assert local_costmap.changes(before, before._replace(cells=before.cells * 0)) == (0, 1)
    for nowhere in (99 + 99j, complex(np.nan, 0.0), complex(0.0, np.inf)):
        assert local_costmap.changes(grid([[0, 0], [0, 0]], nowhere), before) == (0, 0)


@given(st.integers(-4, 4), st.integers(-4, 4))
def test_a_costmap_that_only_rolls_does_not_change(rows, columns):
    scene = np.random.default_rng(3).choice([0, 50, 100], (12, 12))
    before, now = scene[4:8, 4:8], scene[4 + rows : 8 + rows, 4 + columns : 8 + columns]
    moved = grid(now, 0.5 * (columns + 1j * rows))
    assert local_costmap.changes(grid(before), moved) == (0, 0)


def test_costmap_changes_are_rates(extracted):
    empty, full = np.zeros((4, 4)), np.full((4, 4), 100)
    recorded = [
        (2.0 * t, "/local_costmap/costmap", grid_message(t, full if t % 2 else empty, 0.05, 0j))
        for t in range(5)
    ]
    values, *_ = extracted(local_costmap, recorded)
    assert values["lethal_appearing"] == values["lethal_vanishing"] == pytest.approx(4.0)


def test_a_latched_costmap_counts_by_the_time_between_grids(extracted):
    empty, full = np.zeros((4, 4)), np.full((4, 4), 100)
    recorded = [
        (t, "/local_costmap/costmap", grid_message(0, cells, 0.05, 0j))
        for t, cells in ((0.0, empty), (0.01, full), (2.0, full), (4.0, full))
    ]
    values, *_ = extracted(local_costmap, recorded)
    assert values["lethal_appearing"] == pytest.approx(16 / 4.0)
