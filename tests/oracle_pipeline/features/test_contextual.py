import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline import features
from oracle_pipeline.features.engine.plugin import Series, Window
from oracle_pipeline.features.lidar import laser_ranges
from oracle_pipeline.features.motion import odometry
from oracle_pipeline.features.navigation.goals import RootChange, goals_of_log
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.features.rows import columns_of

MANAGER = features.build_manager()


def of_run(path) -> dict:
    """Contextual features of a bag's whole recording, reasons in place of numbers."""
    with open_run(path) as run:
        table = features.extract(run, MANAGER).run
    row = table.iloc[0].to_dict()
    values = {**row, **json.loads(row["missing"])}
    return {k.removeprefix("contextual."): v for k, v in values.items() if "contextual" in k}


def turned(yaws, rates=None, x=None, y=None) -> dict:
    n = len(yaws)
    columns = [np.zeros(n) if c is None else np.asarray(c) for c in (x, y)]
    values = np.column_stack([*columns, yaws, np.zeros(n) if rates is None else rates])
    topics = {"odometry": {"/odom": Series(np.arange(n, dtype=float), values)}}
    return odometry.compute(Window(0.0, 10.0, None, None, (), {}, topics, topics))


def test_yaw_variance_does_not_jump_at_plus_minus_pi():
    assert turned([3.1, -3.1])["yaw_variance"] == pytest.approx(0.00086, abs=1e-5)
    assert turned([3.1, -3.1])["total_turning"] == pytest.approx(2 * np.pi - 6.2)


yaws = st.lists(st.floats(-3.1, 3.1), min_size=1, max_size=20)


@given(yaws, st.floats(-10, 10))
def test_turning_does_not_depend_on_where_yaw_is_zero(yaws, offset):
    ours, theirs = turned(yaws), turned([yaw + offset for yaw in yaws])
    assert ours["total_turning"] == pytest.approx(theirs["total_turning"], abs=1e-9)
    assert ours["yaw_variance"] == pytest.approx(theirs["yaw_variance"], abs=1e-9)
    assert 0 <= ours["yaw_variance"] <= 1


def test_turning_per_metre_needs_metres():
    values = turned([0.0, 1.0, 2.0], x=[0.0, 1.0, 2.0])
    assert values["turning_per_metre"] == pytest.approx(1.0)
    assert "less than 0.1 m" in turned([0.0, 1.0])["turning_per_metre"].reason


def test_speed_counts_the_time_in_which_the_robot_stands():
    assert turned([0.0, 0.0, 0.0], x=[0.0, 3.0, 3.0])["speed"] == pytest.approx(0.3)


def test_yaw_rate_variance_is_that_of_the_measured_rate():
    assert turned([0, 0, 0, 0], rates=[1, -1, 1, -1])["yaw_rate_variance"] == pytest.approx(1.0)


def test_odometry_is_read_from_the_quaternion(messages):
    for yaw in (-3.0, -0.5, 0.0, 2.0):
        kept = odometry.keep(columns_of(messages.odometry(0, 1.0, 2.0, yaw, 0.3)))
        assert np.ravel(kept) == pytest.approx((1.0, 2.0, yaw, 0.3))


@given(st.lists(st.floats(0.25, 3.25, width=32), min_size=1), st.integers(0, 5), st.integers(0, 5))
def test_rays_without_a_range_are_counted_and_change_nothing_else(messages, valid, infs, nans):
    with_others = [*valid, *[np.inf] * infs, *[np.nan] * nans, 9.0, 0.01]
    whole, (variance, non_finite, least) = laser_ranges.keep(
        columns_of(messages.scan(0, valid), messages.scan(0, with_others))
    )
    assert (variance, least) == pytest.approx((whole[0], whole[2]))
    assert variance == pytest.approx(np.var(np.float32(valid).astype(float)), abs=1e-6)
    assert non_finite == pytest.approx((infs + nans) / (len(valid) + infs + nans + 2))


def test_scanners_are_reduced_one_at_a_time(bag_of, messages):
    near = [(t, "/scan", messages.scan(t, [1.0, 3.0])) for t in range(5)]
    far = [(t, "/scan_tom", messages.scan(t, [1.0, 1.0, np.inf, np.inf])) for t in range(5)]
    odd = [(5, "/scan", messages.scan(5, [0.2, 3.4, np.inf]))]  # one scan does not move a median
    values = of_run(bag_of([*near, *far, *odd]))
    assert values["range_variance_max"] == pytest.approx(1.0)
    assert values["range_variance_mean"] == pytest.approx(0.5)
    assert values["non_finite_max"] == pytest.approx(0.5)
    assert values["non_finite_mean"] == pytest.approx(0.25)


def test_clearance_is_that_of_the_scanner_that_sees_farthest(bag_of, messages):
    own_mast = [(t, "/scan", messages.scan(t, [0.3, 3.0])) for t in range(40)]
    free = [(t, "/scan_tom", messages.scan(t, [0.7, 2.0, np.inf])) for t in range(40)]
    near = [
        (40, "/scan_tom", messages.scan(40, [0.4]))
    ]  # one scan in forty is not the 5th percentile
    assert of_run(bag_of([*own_mast, *free, *near]))["clearance"] == pytest.approx(0.7)


def test_a_scanner_without_returns_has_no_value_instead_of_zero(bag_of, messages):
    values = of_run(bag_of([(t, "/scan", messages.scan(t, [np.inf, np.inf])) for t in range(3)]))
    assert values["range_variance_mean"] == "no scan has a valid range"
    assert values["non_finite_mean"] == 1.0


ROOT = "NavigateRecovery"


def test_times_of_goals_come_from_the_tree_if_the_status_is_hidden(bag_of, messages):
    log = messages.tree_log
    values = of_run(
        bag_of(
            [
                (0.0, "/plan", messages.plan(0, 100.0)),
                (1.0, "/behavior_tree_log", log(1, (ROOT, "IDLE", "RUNNING"))),
                (1.5, "/plan", messages.plan(1, 2.0)),
                (2.5, "/plan", messages.plan(2, 50.0)),
                (3.0, "/behavior_tree_log", log(3, ("Spin", "IDLE", "RUNNING"))),
                (5.0, "/behavior_tree_log", log(5, (ROOT, "RUNNING", "SUCCESS"))),
                (5.1, "/behavior_tree_log", log(5, (ROOT, "SUCCESS", "IDLE"))),
                (6.0, "/behavior_tree_log", log(6, (ROOT, "IDLE", "RUNNING"))),
                (6.5, "/plan", messages.plan(6, 3.0)),
                (9.0, "/behavior_tree_log", log(9, (ROOT, "RUNNING", "FAILURE"))),
                (9.5, "/behavior_tree_log", log(9, (ROOT, "IDLE", "RUNNING"))),
                (10.0, "/behavior_tree_log", log(10, (ROOT, "RUNNING", "IDLE"))),
                (11.0, "/plan", messages.plan(11, 1.0)),
            ]
        )
    )
    assert values["duration"] == pytest.approx(4.0 + 3.0 + 0.5)
    assert values["goals_reached"] == pytest.approx(1 / 3)
    assert values["time_per_planned_metre"] == pytest.approx(7.0 / 5.0)


I, R, S, F = "IDLE", "RUNNING", "SUCCESS", "FAILURE"  # noqa: E741 -- as short as in a diagram


@pytest.mark.parametrize(
    ("changes", "ends_s", "expected"),
    [
        ([(1, I + R), (4, R + I, I + S)], 4, [(1, 4, True)]),  # as Nav2 logs it
        ([(1, I + R), (4, R + I, I + F), (4.2, F + I)], 4, [(1, 4, False)]),
        ([(1, I + R), (4, R + S, S + I)], 4, [(1, 4, True)]),
        ([(1, I + R), (4, R + I)], 4, [(1, 4, False)]),  # cancelled
        ([(1, I + R)], 4, [(1, None, False)]),
        ([(3, I + S)], 3, [(3, 3, True)]),
        ([(1, I + R), (4, R + I, I + S, S + I, I + R)], 6, [(1, 4, True), (4, None, False)]),
        ([], 4, []),  # its root has another name
        ([(4, R + I, I + S)], 4, [(0, 4, True)]),  # it ran when the recording began
        ([(1, I + R), (5, S + I, I + R)], 7, [(1, 4, True), (5, None, False)]),  # an end is lost
        ([(1, I + R), (3, R + I, I + S), (6, R + I, I + S)], 6,
         [(1, 3, True), (4, 6, True)]),  # a beginning is lost
        ([(1, I + R), (3, R + I, I + S)], 7, [(1, 3, True), (4, None, False)]),  # the same
    ],
)  # fmt: skip
def test_goals_are_those_of_the_root_of_the_tree(changes, ends_s, expected):
    goals = goals_of_log(log_of(changes), np.arange(1.0, ends_s + 1.0))
    assert [(g.accepted_s, g.ended_s, g.reached) for g in goals] == expected


def test_messages_of_the_tree_may_come_in_another_order():
    ordered = [(1, I + R), (3, R + I, I + S), (4, S + I, I + R), (6, R + I, I + S)]
    log = log_of(ordered)
    swapped = Series(np.array([1.0, 3.002, 3.001, 6.0]), log.values)
    goals = goals_of_log(swapped, swapped.times_s)
    assert [goal.reached for goal in goals] == [True, True]


def log_of(changes):
    """Return what is kept of messages, each (time, former and new state of the root, ...)."""
    pairs = {a + b: (a, b) for a in (I, R, S, F) for b in (I, R, S, F)}
    kept = [[RootChange(time, *pairs[each]) for each in rest] for time, *rest in changes]
    values = np.fromiter(kept, dtype=object, count=len(kept))
    return Series(np.array([time for time, *_ in changes], dtype=float), values)


def test_times_of_goals_come_from_the_status_if_it_is_recorded(bag_of, messages):
    topic = "/navigate_to_pose/_action/status"
    status = messages.goal_status
    values = of_run(
        bag_of(
            [
                (0.0, topic, status(0, (9, 4))),  # of before the recording
                (1.0, topic, status(1, (9, 4), (1, 1))),
                (1.1, topic, status(1, (9, 4), (1, 2))),
                (4.0, topic, status(4, (1, 4))),
                (5.0, topic, status(5, (1, 4), (2, 2))),
                (5.0, "/behavior_tree_log", messages.tree_log(5, (ROOT, "IDLE", "RUNNING"))),
                (8.0, topic, status(8, (2, 6))),
            ]
        )
    )
    assert values["duration"] == pytest.approx(6.0)
    assert values["goals_reached"] == pytest.approx(0.5)
    assert values["time_per_planned_metre"] == "no plan is recorded"


@pytest.mark.parametrize(
    ("told", "duration", "reached"),
    [
        ([(4.0, (1, 4)), (5.0, (1, 4), (2, 1)), (8.0, (2, 4))], 4.0 + 3.0, 1.0),  # began under way
        ([(1.0, (1, 1)), (4.0, (1, 4)), (8.0, (1, 4), (2, 4))], 3.0 + 4.0, 1.0),  # one was lost
        ([(1.0, (1, 1)), (4.0, (1, 4)), (6.0, (1, 4), (2, 1))], 3.0 + 2.0, 1.0),  # ended under way
        ([(1.0, (1, 1)), (2.0, (1, 4)), (3.0, (1, 4), (2, 1))], 1.0 + 5.0, 0.5),  # takes too long
    ],
)
def test_a_recording_may_lack_the_beginning_or_end_of_goals(
    bag_of, messages, told, duration, reached
):
    status, topic = messages.goal_status, "/navigate_to_pose/_action/status"
    scans = [(t, "/scan", messages.scan(t, [1.0])) for t in (0.0, 8.0)]
    values = of_run(bag_of([*scans, *((t, topic, status(t, *rest)) for t, *rest in told)]))
    assert values["duration"] == pytest.approx(duration)
    assert values["goals_reached"] == pytest.approx(reached)


def test_it_is_not_known_whether_a_tree_that_ran_before_the_recording_has_a_goal(bag_of, messages):
    ticks = [
        (float(t), "/behavior_tree_log", messages.tree_log(t, ("Wait", I, R))) for t in range(4)
    ]
    assert "before the recording" in of_run(bag_of(ticks))["duration"]


def test_without_navigation_there_is_a_reason(bag_of, messages):
    values = of_run(bag_of([(0, "/scan", messages.scan(0, [1.0]))]))
    assert "neither a goal status nor a behaviour tree log" in values["duration"]
    assert values["total_turning"] == "no topic for the role odometry is recorded"


def test_a_goal_under_way_counts_in_each_window(make_run):
    with open_run(make_run().path) as run:
        tables = features.extract(run, MANAGER)
    assert tables.run["contextual.duration"].tolist() == pytest.approx([20.0 + 3.0])
    windows = dict(zip(tables.windows["window_start_s"], tables.windows["contextual.duration"],
                       strict=True))  # fmt: skip
    assert [windows[start_s] for start_s in (0.0, 2.5, 5.0, 10.0)] == pytest.approx(
        [3.0, 5.0, 5.0, 5.0]
    )
    assert sum(windows[5.0 * n] for n in range(5)) == pytest.approx(21.0)  # of 25 s
    assert tables.run["contextual.time_per_planned_metre"].tolist() == pytest.approx([5.0])
