"""DWB's debug messages against rosbags' own serialisation and a slow copy of Nav2's scoring."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.bags.types import deserialize, message_class, serialize
from sim.middleware.geometry import Pose2D
from sim.middleware.stamps import duration_message, header
from sim.nav2 import dwb_sampling
from sim.nav2.dwb import LocalPlanner
from sim.nav2.dwb_critics import CostGrid
from sim.nav2.dwb_debug import (
    CRITICS,
    EVALUATION,
    LIFETIME_NS,
    LINE_STRIP,
    LINE_WIDTH_M,
    MARKERS,
    evaluate,
    evaluation_bytes,
    marker_bytes,
)
from sim.nav2.dwb_sampling import Parameters

CELLS, RESOLUTION = 60, 0.05
HALF = CELLS * RESOLUTION / 2

ColorRGBA = message_class("std_msgs/msg/ColorRGBA")
CompressedImage = message_class("sensor_msgs/msg/CompressedImage")
CriticScore = message_class("dwb_msgs/msg/CriticScore")
LocalPlanEvaluation = message_class(EVALUATION)
Marker = message_class("visualization_msgs/msg/Marker")
MarkerArray = message_class(MARKERS)
MeshFile = message_class("visualization_msgs/msg/MeshFile")
Point = message_class("geometry_msgs/msg/Point")
Pose = message_class("geometry_msgs/msg/Pose")
PosePlanar = message_class("geometry_msgs/msg/Pose2D")
Quaternion = message_class("geometry_msgs/msg/Quaternion")
Trajectory2D = message_class("dwb_msgs/msg/Trajectory2D")
TrajectoryScore = message_class("dwb_msgs/msg/TrajectoryScore")
Twist2D = message_class("nav_2d_msgs/msg/Twist2D")
Vector3 = message_class("geometry_msgs/msg/Vector3")


def free_grid():
    return CostGrid(np.zeros((CELLS, CELLS), np.uint8), RESOLUTION, -HALF, -HALF)


def line(length, yaw=0.0):
    along = np.arange(0.0, length + 1e-9, 0.025)
    return np.column_stack([along * math.cos(yaw), along * math.sin(yaw), np.full(len(along), yaw)])


def cycle_of(grid, plan, pose, velocity, **parameters):
    planner = LocalPlanner(Parameters(**parameters))
    planner.set_plan(plan)
    return planner.compute(grid, pose, velocity, Pose2D())


@st.composite
def cycles(draw, **parameters):
    """Cycles in a world of random costs: cruising, beside the goal, at the edge of the costmap."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    grid = free_grid()
    grid.costs[:] = rng.integers(0, 252, grid.costs.shape)
    grid.costs[rng.random(grid.costs.shape) < draw(st.sampled_from([0.0, 0.02, 0.2]))] = 254
    at_edge = draw(st.booleans())
    plan = line(draw(st.sampled_from([0.15, 1.2])), rng.uniform(-3.0, 3.0))
    plan[:, 0] += 1.35 * at_edge
    x, y = (plan[0, :2] + rng.uniform(-0.1, 0.1, 2)).tolist()
    pose = Pose2D(x, y, rng.uniform(-3.0, 3.0))
    planner = LocalPlanner(Parameters(**parameters))
    planner.set_plan(plan)
    if draw(st.booleans()):
        planner._turns.debrief((0.0, 1.0), pose)
        planner._turns.debrief((0.0, -1.0), pose)
    velocity = draw(st.sampled_from([0.0, 0.1, 0.26])), draw(st.floats(-1.0, 1.0))
    return planner.compute(grid, pose, velocity, Pose2D())


few = cycles(vx_samples=2, vtheta_samples=3, trans_stopped_velocity=0.05)


# -- bytes ---------------------------------------------------------------------------------


def trajectories(evaluation):
    return np.split(evaluation.poses, evaluation.ends[:-1])


def evaluation_message(time_ns, frame, evaluation):
    scored = []
    for i, poses in enumerate(trajectories(evaluation)):
        refused_by = evaluation.refused_by[i]
        scores = [
            CriticScore(CRITICS[c], evaluation.raw_scores[i, c], evaluation.scales[c])
            for c in range(evaluation.asked[i])
        ]
        if refused_by >= 0:
            scores = [CriticScore(CRITICS[refused_by], -1.0, 0.0)]
        offsets, offset = [], 0.0
        for _ in poses[1:]:
            offsets.append(duration_message(int(offset * 1e9)))
            offset += evaluation.sim_time / (len(poses) - 2)
        v, w = evaluation.twists[i]
        trajectory = Trajectory2D(Twist2D(v, 0.0, w), offsets, [PosePlanar(*p) for p in poses])
        scored.append(TrajectoryScore(trajectory, scores, evaluation.totals[i]))
    return LocalPlanEvaluation(header(time_ns, frame), scored, evaluation.best, evaluation.worst)


def marker_message(time_ns, frame, evaluation):
    best = float(evaluation.totals[evaluation.best])
    spread = float(evaluation.totals[evaluation.worst]) - best or 1.0
    markers = []
    for total, poses in zip(evaluation.totals, trajectories(evaluation), strict=True):
        level = (float(total) - best) / spread
        namespace = "ValidTrajectories" if total >= 0 else "InvalidTrajectories"
        colour = ColorRGBA(level, 1.0 - level, 0.0, 1.0)
        markers.append(
            Marker(
                header(time_ns, frame),
                namespace,
                sum(marker.ns == namespace for marker in markers),
                LINE_STRIP,
                0,
                Pose(Point(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
                Vector3(LINE_WIDTH_M, 0.0, 0.0),
                colour if total >= 0 else ColorRGBA(0.0, 0.0, 0.0, 1.0),
                duration_message(LIFETIME_NS),
                False,
                [Point(x, y, 0.0) for x, y, _ in poses],
                [],
                "",
                CompressedImage(header(0, ""), "", np.zeros(0, np.uint8)),
                [],
                "",
                "",
                MeshFile("", np.zeros(0, np.uint8)),
                False,
            )
        )
    return MarkerArray(markers)


@pytest.mark.slow
@settings(max_examples=15)
@given(few, st.integers(0, 2**60), st.text("abcd/_", max_size=9))
def test_the_bytes_are_those_that_serialising_the_messages_gives(cycle, time_ns, frame):
    evaluation = evaluate(cycle.scoring)
    for data, message, msgtype in (
        (evaluation_bytes, evaluation_message, EVALUATION),
        (marker_bytes, marker_message, MARKERS),
    ):
        expected = serialize(message(time_ns, frame, evaluation), msgtype)
        assert data(time_ns, frame, evaluation) == expected


def test_at_cruise_the_messages_are_as_large_as_on_humble():
    cycle = cycle_of(free_grid(), line(2.0), Pose2D(0.0, 0.1, 0.1), (0.26, 0.0), sim_time=1.7)
    evaluation = evaluate(cycle.scoring)
    assert len(evaluation.ends) == 419
    assert len(evaluation_bytes(0, "odom", evaluation)) == pytest.approx(552_000, rel=0.1)
    assert len(marker_bytes(0, "odom", evaluation)) == pytest.approx(475_000, rel=0.01)


# -- scores --------------------------------------------------------------------------------


class IllegalTrajectoryError(Exception):
    pass


def naive_critics(scoring, twist, rollout):
    """Yield name, raw score and scale of each critic in turn."""
    p, grid, critics = scoring.parameters, scoring.grid, scoring.critics
    (v, w), (x, y, yaw) = twist, rollout[-1]

    def cell(x, y):
        column = math.floor((x - grid.origin_x) / grid.resolution)
        row = math.floor((y - grid.origin_y) / grid.resolution)
        if not (0 <= column < CELLS and 0 <= row < CELLS):
            raise IllegalTrajectoryError
        return row, column

    def manhattan(here, goal_x, goal_y):
        return abs(here[1] - goal_x) + abs(here[0] - goal_y)

    def to_path(cell):
        return critics.path_distance[cell[0] - critics.low, cell[1] - critics.left]

    rotation = 0.0
    if critics.slowing or critics.rotating:
        if v > 0.0 if critics.rotating else v * v >= critics.speed_squared:
            raise IllegalTrajectoryError
        rotation = abs(math.remainder(critics.goal_yaw - yaw, 2.0 * math.pi))
        rotation += 0.0 if critics.rotating else p.slowing_factor * v * v
    yield rotation, p.rotate_to_goal_scale
    if critics.turn * w < 0.0:
        raise IllegalTrajectoryError
    yield 0.0, 1.0
    costs = [grid.costs[cell(x, y)] for x, y, _ in rollout]
    if max(costs) >= 253:
        raise IllegalTrajectoryError
    yield float(costs[-1]), p.base_obstacle_scale
    half = 0.5 * grid.resolution
    nose = cell(x + 0.1 * math.cos(yaw), y + 0.1 * math.sin(yaw))
    yield manhattan(nose, critics.nose_x, critics.nose_y), half * p.goal_align_scale
    if critics.align_path:
        yield to_path(nose), half * p.path_align_scale
    else:
        yield 0.0, 0.0
    if critics.goal_x < 0:
        raise IllegalTrajectoryError
    yield to_path(cell(x, y)), half * p.path_dist_scale
    yield manhattan(cell(x, y), critics.goal_x, critics.goal_y), half * p.goal_dist_scale


@settings(max_examples=15)
@given(cycles(vx_samples=5, vtheta_samples=6, trans_stopped_velocity=0.05))
def test_every_trajectory_is_scored_as_nav2_scores_it(cycle):
    message = deserialize(evaluation_bytes(0, "odom", evaluate(cycle.scoring)), EVALUATION)
    p, velocity = cycle.scoring.parameters, cycle.scoring.velocity
    best, rounding = math.inf, 1e-9
    for score in message.twists:
        twist = score.traj.velocity.x, score.traj.velocity.theta
        rollout = np.empty((dwb_sampling.step_count(p, twist) + 2, 3))
        dwb_sampling.roll(p, cycle.scoring.pose, velocity, twist, rollout)
        assert [(pose.x, pose.y, pose.theta) for pose in score.traj.poses] == [*map(tuple, rollout)]
        opinions = []
        try:
            opinions.extend(naive_critics(cycle.scoring, twist, rollout))
        except IllegalTrajectoryError:
            refusal = CriticScore(CRITICS[len(opinions)], -1.0, 0.0)
        sums = np.cumsum([raw_score * scale for raw_score, scale in opinions])
        limit = best if best > 0.0 else math.inf
        if score.total == -1.0:
            assert score.scores == [refusal]
            assert (sums <= limit + rounding).all()
            continue
        asked = len(score.scores)
        assert [s.name for s in score.scores] == [*CRITICS[:asked]]
        assert [(s.raw_score, s.scale) for s in score.scores] == [
            pytest.approx(opinion, rel=1e-6) for opinion in opinions[:asked]
        ]
        assert score.total == pytest.approx(sums[asked - 1], rel=1e-6)
        assert asked == len(CRITICS) or sums[asked - 1] >= limit - rounding
        assert (sums[: asked - 1] <= limit + rounding).all()
        best = min(best, sums[asked - 1])


@given(few)
def test_the_best_is_the_twist_that_the_planner_chose_and_the_worst_has_the_highest_total(cycle):
    evaluation = evaluate(cycle.scoring)
    legal = evaluation.refused_by < 0
    if cycle.twist is None:
        assert not legal.any()
        assert (evaluation.best, evaluation.worst) == (0, 0)
    else:
        assert tuple(evaluation.twists[evaluation.best]) == cycle.twist
        assert evaluation.totals[evaluation.best] == evaluation.totals[legal].min()
        assert evaluation.totals[evaluation.worst] == evaluation.totals[legal].max()
        assert evaluation.asked[evaluation.best] == len(CRITICS)


def test_in_a_wall_all_trajectories_are_shown_as_invalid():
    grid = free_grid()
    grid.costs[:] = 254
    evaluation = evaluate(cycle_of(grid, line(2.0), Pose2D(), (0.0, 0.0)).scoring)
    message = deserialize(evaluation_bytes(0, "odom", evaluation), EVALUATION)
    assert {s.name for twist in message.twists for s in twist.scores} == {"BaseObstacle"}
    markers = deserialize(marker_bytes(0, "odom", evaluation), MARKERS).markers
    assert {marker.ns for marker in markers} == {"InvalidTrajectories"}
    assert [marker.id for marker in markers] == list(range(len(markers)))
