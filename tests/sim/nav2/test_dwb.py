"""DWB against hand-computed cases and against a slow, obvious copy of its scoring."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from sim.middleware.geometry import Pose2D
from sim.nav2 import dwb, dwb_critics, dwb_sampling
from sim.nav2.costmap import CostGrid
from sim.nav2.dwb import LocalPlanner
from sim.nav2.dwb_critics import Critics
from sim.nav2.dwb_sampling import Parameters, Start

STOCK = Parameters(sim_time=1.7)  # the figures of the stock rollout are known
CELLS, RESOLUTION = 60, 0.05
HALF = CELLS * RESOLUTION / 2
MAP_TO_ODOM = Pose2D()


def free_grid():
    return CostGrid(np.zeros((CELLS, CELLS), np.uint8), RESOLUTION, -HALF, -HALF)


def straight_plan(length=2.0, yaw=0.0):
    along = np.arange(0.0, length + 1e-9, 0.025)
    return np.column_stack([along * math.cos(yaw), along * math.sin(yaw), np.full(len(along), yaw)])


def planner_on(plan, **parameters):
    planner = LocalPlanner(Parameters(**parameters))
    planner.set_plan(plan)
    return planner


# -- sampling and rollout ------------------------------------------------------------------


def test_a_cruising_robot_has_419_twists_to_try():
    forward = dwb_sampling.samples(0.26, 0.0, 0.26, 2.5 * 1.7, -2.5 * 1.7, 20)
    turning = dwb_sampling.samples(0.0, -1.0, 1.0, 3.2 * 1.7, -3.2 * 1.7, 20)
    assert (len(forward), len(turning)) == (20, 21)  # zero joins the even number of turns
    assert forward[[0, -1]] == pytest.approx([0.0, 0.26])
    assert np.count_nonzero(turning == 0.0) == 1
    twists = {(v, w) for v in forward for w in turning} - {(0.0, 0.0)}
    assert len(twists) == 419


def test_samples_stay_within_what_can_be_reached():
    assert dwb_sampling.samples(0.0, -1.0, 1.0, 0.2, -0.1, 3) == pytest.approx(
        [-0.1, 0.0, 0.05, 0.2]
    )


@given(v=st.floats(0.0, 0.26), w=st.floats(-1.0, 1.0))
def test_a_rollout_has_3_to_70_poses_and_its_last_one_twice(v, w):
    rollout = np.empty((dwb_sampling.step_count(STOCK, (v, w)) + 2, 3))
    assert dwb_sampling.roll(Start(STOCK, (0.0, 0.0, 0.0), (0.0, 0.0)), (v, w), rollout) == len(
        rollout
    )
    assert 3 <= len(rollout) <= 70
    assert rollout[0] == pytest.approx([0.0, 0.0, 0.0])
    assert np.array_equal(rollout[-1], rollout[-2])


def test_a_rollout_at_cruise_is_straight_and_1_7_seconds_long():
    rollout = np.empty((dwb_sampling.step_count(STOCK, (0.26, 0.0)) + 2, 3))
    dwb_sampling.roll(Start(STOCK, (1.0, 2.0, math.pi / 2), (0.26, 0.0)), (0.26, 0.0), rollout)
    assert len(rollout) == 11  # 0.442 m in steps of at most 0.05 m
    assert rollout[-1] == pytest.approx([1.0, 2.442, math.pi / 2])


def test_a_rollout_from_standstill_accelerates_first():
    steps = dwb_sampling.step_count(STOCK, (0.26, 0.0))
    rollout = np.empty((steps + 2, 3))
    dwb_sampling.roll(Start(STOCK, (0.0, 0.0, 0.0), (0.0, 0.0)), (0.26, 0.0), rollout)
    dt = 1.7 / steps  # 0.189 s: 2.5 m/s^2 reach full speed within the first step
    assert np.diff(rollout[:, 0])[:-1] == pytest.approx(np.full(steps, 0.26 * dt))


@given(w=st.floats(0.05, 1.0), yaw=st.floats(-3.0, 3.0))
def test_the_stepwise_heading_is_that_of_the_exact_angle(w, yaw):
    rollout = np.empty((dwb_sampling.step_count(STOCK, (0.26, w)) + 2, 3))
    dwb_sampling.roll(Start(STOCK, (0.0, 0.0, yaw), (0.0, 0.0)), (0.26, w), rollout)
    chords = np.diff(rollout[:-1, :2], axis=0)
    headings = np.arctan2(chords[:, 1], chords[:, 0])
    assert np.exp(1j * headings) == pytest.approx(np.exp(1j * rollout[:-2, 2]))


# -- choice --------------------------------------------------------------------------------


def test_in_a_straight_corridor_it_drives_straight_and_fast():
    grid = free_grid()
    for rows in (slice(0, 20), slice(40, 60)):  # walls 0.5 m to either side
        grid.costs[rows] = 254
    cycle = planner_on(straight_plan()).compute(grid, Pose2D(), (0.26, 0.0), MAP_TO_ODOM)
    assert cycle.twist is not None
    assert cycle.twist[0] > 0.2
    assert cycle.twist[1] == 0.0
    assert np.abs(cycle.trajectory[:, 1]).max() == 0.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_beside_the_path_it_turns_towards_it(side):
    cycle = planner_on(straight_plan()).compute(
        free_grid(), Pose2D(0.0, 0.3 * side), (0.26, 0.0), MAP_TO_ODOM
    )
    assert cycle.twist is not None
    assert cycle.twist[1] * side < 0.0


def test_a_wall_all_around_leaves_no_legal_trajectory():
    grid = free_grid()
    grid.costs[:] = 253
    cycle = planner_on(straight_plan()).compute(grid, Pose2D(), (0.0, 0.0), MAP_TO_ODOM)
    assert cycle.twist is None
    assert len(cycle.trajectory) == 0


@pytest.mark.parametrize("forward", [8.0, 50.0, math.inf, math.nan])
@pytest.mark.parametrize("turning", [0.0, -9.0, 40.0, math.inf, math.nan])
def test_an_odometry_that_is_far_too_fast_or_no_number_does_no_harm(forward, turning):
    cycle = planner_on(straight_plan()).compute(
        free_grid(), Pose2D(), (forward, turning), MAP_TO_ODOM
    )
    assert cycle.twist is None or np.isfinite(cycle.twist).all()


def test_a_plan_that_is_nowhere_near_is_not_followed():
    far = straight_plan() + np.array([10.0, 0.0, 0.0])
    cycle = planner_on(far).compute(free_grid(), Pose2D(), (0.0, 0.0), MAP_TO_ODOM)
    assert cycle.twist is None


def test_the_plan_is_cut_to_the_costmap_and_what_was_passed_is_forgotten():
    planner = planner_on(straight_plan(6.0))
    cycle = planner.compute(free_grid(), Pose2D(), (0.0, 0.0), MAP_TO_ODOM)
    assert cycle.plan[[0, -1], 0] == pytest.approx([0.0, 1.5])
    grid = free_grid()._replace(origin_x=2.0 - HALF)
    cycle = planner.compute(grid, Pose2D(2.0, 0.0), (0.0, 0.0), MAP_TO_ODOM)
    assert cycle.plan[[0, -1], 0] == pytest.approx([0.525, 3.5])
    assert planner.plan[0, 0] == pytest.approx(0.525)


def test_the_plan_is_taken_into_the_costmaps_frame():
    from_plan = Pose2D(0.5, 0.0, math.pi / 2)
    cycle = planner_on(straight_plan()).compute(
        free_grid(), Pose2D(0.5, 0.0, math.pi / 2), (0.26, 0.0), from_plan
    )
    assert cycle.plan[-1] == pytest.approx([0.5, 1.5, math.pi / 2], abs=0.03)
    assert cycle.twist is not None
    assert abs(cycle.twist[1]) < 0.2  # straight on, but for equal scores of neighbouring samples


def test_at_the_goal_it_turns_on_the_spot_towards_the_goals_yaw():
    plan = straight_plan(0.2)
    plan[-1, 2] = 2.0
    planner = planner_on(plan)
    cycle = planner.compute(free_grid(), Pose2D(), (0.1, 0.0), MAP_TO_ODOM)
    assert cycle.twist is not None
    assert cycle.twist[0] == 0.0
    assert cycle.twist[1] == pytest.approx(1.0)


def test_at_the_goal_and_still_fast_it_slows_down():
    planner = planner_on(straight_plan(0.2), trans_stopped_velocity=0.1)
    cycle = planner.compute(free_grid(), Pose2D(), (0.2, 0.0), MAP_TO_ODOM)
    assert cycle.twist is not None
    assert cycle.twist[0] < 0.2


def test_turning_back_and_forth_on_the_spot_is_forbidden_until_the_robot_got_on():
    trend = dwb._Trend()
    trend.debrief((0.0, 0.5), Pose2D())
    assert trend.only == 0
    trend.debrief((0.0, -0.5), Pose2D())
    assert trend.only == -1  # no more turning left
    trend.debrief((0.0, -0.5), Pose2D(yaw=-0.15))
    assert trend.only == -1
    trend.debrief((0.0, -0.5), Pose2D(yaw=-0.25))
    assert trend.only == 0


def test_turning_while_driving_is_no_oscillation():
    trend = dwb._Trend()
    for turn in (0.5, -0.5, 0.5):
        trend.debrief((0.1, turn), Pose2D())
    assert trend.only == 0


def test_an_oscillating_robot_gets_no_twist_to_the_forbidden_side():
    plan = straight_plan(2.0, yaw=3.0)  # behind, to the left
    planner = planner_on(plan)
    planner._turns.debrief((0.0, 1.0), Pose2D())
    planner._turns.debrief((0.0, -1.0), Pose2D())
    cycle = planner.compute(free_grid(), Pose2D(), (0.0, 0.0), MAP_TO_ODOM)
    assert cycle.twist is not None
    assert cycle.twist[1] <= 0.0


def test_a_speed_limit_scales_both_speeds_and_zero_lifts_it():
    planner = planner_on(straight_plan())
    planner.limit_speed(50.0, percentage=True)
    cycle = planner.compute(free_grid(), Pose2D(), (0.0, 0.0), MAP_TO_ODOM)
    assert cycle.twist is not None
    assert 0.1 < cycle.twist[0] <= 0.13
    planner.limit_speed(0.0, percentage=False)
    cycle = planner.compute(free_grid(), Pose2D(), (0.0, 0.0), MAP_TO_ODOM)
    assert cycle.twist is not None
    assert cycle.twist[0] > 0.2


# -- the slow, obvious copy ----------------------------------------------------------------


def naive_totals(grid, pose, velocity, plan):
    """Score every twist by the definitions of the critics; return twist -> total of the legal."""
    p = Parameters()

    def cell(x, y):
        return (
            math.floor((x - grid.origin_x) / grid.resolution),
            math.floor((y - grid.origin_y) / grid.resolution),
        )

    def on_grid(column, row):
        return 0 <= column < CELLS and 0 <= row < CELLS

    on_path = np.ones((CELLS, CELLS), bool)
    goal = None
    for x, y, _ in plan:
        column, row = cell(x, y)
        if on_grid(column, row):
            on_path[row, column] = False
            goal = (column, row)
        elif goal is not None:
            break
    distance = ndimage.distance_transform_cdt(on_path, metric="taxicab")
    ahead = math.atan2(plan[-1, 1] - pose.y, plan[-1, 0] - pose.x)
    nose = cell(plan[-1, 0] + 0.1 * math.cos(ahead), plan[-1, 1] + 0.1 * math.sin(ahead))
    totals = {}
    for v in np.linspace(0.0, 0.26, 20):
        for w in sorted({*np.linspace(-1.0, 1.0, 20), 0.0}):
            if v == 0.0 and w == 0.0:
                continue
            steps = max(1, math.ceil(max(v / 0.05, abs(w) / 0.025) * p.sim_time))
            dt = p.sim_time / steps
            x, y, yaw = pose.x, pose.y, pose.yaw
            speed, turn = velocity
            legal = grid.costs[cell(x, y)[::-1]] < 253
            for _ in range(steps):
                speed += min(max(v - speed, -2.5 * dt), 2.5 * dt)
                turn += min(max(w - turn, -3.2 * dt), 3.2 * dt)
                x, y = x + speed * math.cos(yaw) * dt, y + speed * math.sin(yaw) * dt
                yaw += turn * dt
                legal = legal and grid.costs[cell(x, y)[::-1]] < 253
            if not legal:
                continue
            front = cell(x + 0.1 * math.cos(yaw), y + 0.1 * math.sin(yaw))
            here = cell(x, y)
            totals[v, w] = 0.02 * grid.costs[here[::-1]] + 0.5 * RESOLUTION * (
                p.goal_align_scale * (abs(front[0] - nose[0]) + abs(front[1] - nose[1]))
                + p.path_align_scale * distance[front[::-1]]
                + p.path_dist_scale * distance[here[::-1]]
                + p.goal_dist_scale * (abs(here[0] - goal[0]) + abs(here[1] - goal[1]))
            )
    return totals


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    yaw=st.floats(-3.0, 3.0),
    speed=st.floats(0.0, 0.26),
    turn=st.floats(-1.0, 1.0),
)
def test_the_choice_follows_the_definitions_of_the_critics(seed, yaw, speed, turn):
    rng = np.random.default_rng(seed)
    grid = free_grid()
    grid.costs[:] = rng.integers(0, 252, grid.costs.shape)
    grid.costs[rng.random(grid.costs.shape) < 0.02] = 254
    plan = straight_plan(1.2, yaw=rng.uniform(-3.0, 3.0))
    pose = Pose2D(*rng.uniform(-0.2, 0.2, 2), yaw)
    cycle = planner_on(plan).compute(grid, pose, (speed, turn), MAP_TO_ODOM)
    totals = naive_totals(grid, pose, (speed, turn), plan)
    if cycle.twist is None:
        assert totals == {}
    else:
        chosen = min(totals, key=lambda twist: math.dist(twist, cycle.twist))
        assert cycle.twist == pytest.approx(chosen)
        assert totals[chosen] == pytest.approx(min(totals.values()))


@given(
    seed=st.integers(0, 2**31),
    place=st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)),
    reach=st.integers(0, 40),
)
def test_distances_around_the_robot_are_those_over_the_whole_costmap(seed, place, reach):
    rng = np.random.default_rng(seed)
    grid = free_grid()
    grid.costs[:] = rng.choice([0, 255], grid.costs.shape, p=[0.9, 0.1])
    plan = np.column_stack([rng.uniform(-1.6, 1.6, (2, 2)), np.zeros(2)])
    around, left, low, *points = dwb_critics.map_plan(grid, plan, *place, reach, (0.1, 0.0))
    whole, _, _, *same = dwb_critics.map_plan(grid, plan, *place, CELLS, (0.1, 0.0))
    rows, columns = around.shape
    np.testing.assert_array_equal(around, whole[low : low + rows, left : left + columns])
    assert whole.shape == grid.costs.shape
    assert points == same


# -- the search ------------------------------------------------------------------------------


def map_cells(p, grid, critics, end):
    """Return the scores of goal align, path align, path dist and goal dist; None outside."""
    ahead = end[:2] + 0.1 * np.array([math.cos(end[2]), math.sin(end[2])])
    points = [
        (point - (grid.origin_x, grid.origin_y)) / grid.resolution for point in (end[:2], ahead)
    ]
    if not all(0.0 <= value < 60.0 for point in points for value in point):
        return None
    (x, y), (ahead_x, ahead_y) = np.array(points, int).tolist()
    return (
        abs(ahead_x - critics.nose_x) + abs(ahead_y - critics.nose_y),
        int(critics.path_distance[ahead_y, ahead_x]) if critics.align_path else 0,
        int(critics.path_distance[y, x]),
        abs(x - critics.goal_x) + abs(y - critics.goal_y),
    )


def tried_one_by_one(p, grid, pose, velocity, critics):
    """Return the twist that `search` returns: every one is rolled out and scored."""
    best = (math.inf, math.nan, math.nan)
    rollout = np.empty((dwb_sampling.step_count(p, (p.max_vel_x, p.max_vel_theta)) + 2, 3))
    forward, turning = dwb_sampling.twists(p, velocity)
    for v in forward.tolist():
        for w in turning.tolist():
            too_fast = critics.rotating and v > 0.0
            too_fast |= critics.slowing and v * v >= critics.speed_squared
            if too_fast or (v == w == 0.0) or critics.turn * w < 0.0:
                continue
            poses = rollout[: dwb_sampling.roll(Start(p, pose, velocity), (v, w), rollout)]
            cost = dwb_critics.obstacle_cost(grid, poses)
            cells = map_cells(p, grid, critics, poses[-1])
            if cells is None:
                continue
            goal_align, path_align, path_dist, goal_dist = cells
            total = p.goal_align_scale * goal_align + p.goal_dist_scale * goal_dist
            total += p.path_dist_scale * path_dist
            total = 0.5 * grid.resolution * (total + p.path_align_scale * path_align)
            total += p.rotate_to_goal_scale * dwb_critics.rotate_to_goal(
                p, critics, v, poses[-1, 2]
            )
            total += p.base_obstacle_scale * cost
            if cost >= 0 and total < best[0]:
                best = (total, v, w)
    return best[1:]


round_or_any = st.sampled_from([0.0, 0.05, -0.1, 0.25]) | st.floats(-0.3, 0.3)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**31),
    pose=st.tuples(round_or_any, round_or_any, st.floats(-3.0, 3.0) | st.just(math.pi / 2)),
    velocity=st.tuples(st.sampled_from([0.0, 0.26]) | st.floats(0.0, 0.26), st.floats(-1.0, 1.0)),
    turn=st.sampled_from([0, 0, 1, -1]),
    near=st.sampled_from(["far", "slowing", "rotating"]),
)
def test_the_search_finds_what_rolling_out_every_twist_finds(seed, pose, velocity, turn, near):
    rng = np.random.default_rng(seed)
    costs = rng.choice(np.array([0, 50, 253, 255], np.uint8), (60, 60), p=[0.8, 0.17, 0.02, 0.01])
    columns = rng.integers(60, size=4).tolist()
    critics = Critics(
        rng.integers(0, 120, (60, 60), np.int32), 0, 0, *columns, float(rng.uniform(-3.0, 3.0)),
        bool(rng.integers(2)), near == "slowing", near == "rotating", velocity[0] ** 2, turn,
    )  # fmt: skip
    scoring = (Parameters(), CostGrid(costs, 0.05, -1.5, -1.5), pose, velocity, critics)
    start = Start(Parameters(), pose, velocity)
    *twist, rollout = dwb_critics.search(start, scoring[1], critics)
    assert tuple(twist) == pytest.approx(tried_one_by_one(*scoring), rel=0.0, abs=0.0, nan_ok=True)
    expected = np.empty((0, 3))
    if not math.isnan(twist[0]):
        expected = np.empty((dwb_sampling.step_count(Parameters(), tuple(twist)) + 2, 3))
        dwb_sampling.roll(start, tuple(twist), expected)
    np.testing.assert_array_equal(rollout, expected)
