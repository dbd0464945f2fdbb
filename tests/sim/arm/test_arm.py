"""Kinematics, plans and physics of the arm, and short runs: normal, and with faults."""

import math

import numpy as np
import pytest

from oracle_pipeline.bags.reader import BagReader, read_ground_truth
from oracle_pipeline.graphs.differences import graph_differences
from oracle_pipeline.graphs.intervals import read_intervals
from sim.arm.cell import GRIP_M, HOME, JOINTS, MAX_SPEED, downward, frames, over, solve
from sim.arm.trajectories import along, duration_s, from_message, plan, touches
from sim.arm.world import World
from sim.campaigns import Campaign
from sim.experiments import recipe_for
from sim.middleware import qos
from sim.modes import find_mode

CAMPAIGN = Campaign(goals_per_run=1)
SECOND = 1_000_000_000
FACTS = {
    "/clock": ("rosgraph_msgs/msg/Clock", qos.CLOCK),
    "/collision_object": ("moveit_msgs/msg/CollisionObject", qos.RELIABLE),
    "/display_planned_path": ("moveit_msgs/msg/DisplayTrajectory", qos.RELIABLE),
    "/force_torque_sensor_broadcaster/wrench": ("geometry_msgs/msg/WrenchStamped", qos.RELIABLE),
    "/joint_states": ("sensor_msgs/msg/JointState", qos.RELIABLE),
    "/joint_trajectory_controller/controller_state": (
        "control_msgs/msg/JointTrajectoryControllerState", qos.RELIABLE),
    "/joint_trajectory_controller/joint_trajectory": (
        "trajectory_msgs/msg/JointTrajectory", qos.DEFAULT),
    "/joint_trajectory_controller/state": (
        "control_msgs/msg/JointTrajectoryControllerState", qos.RELIABLE),
    "/monitored_planning_scene": ("moveit_msgs/msg/PlanningScene", qos.profile(100)),
    "/object_pose": ("geometry_msgs/msg/PoseStamped", qos.SENSOR_DATA),
    "/planning_scene": ("moveit_msgs/msg/PlanningScene", qos.RELIABLE),
    "/robot_description": ("std_msgs/msg/String", qos.LATCHED),
    "/tf": ("tf2_msgs/msg/TFMessage", qos.TF),
    "/tf_static": ("tf2_msgs/msg/TFMessage", qos.LATCHED),
}  # fmt: skip
RATES = {
    "/clock": 100,
    "/force_torque_sensor_broadcaster/wrench": 100,
    "/joint_states": 100,
    "/joint_trajectory_controller/controller_state": 50,
    "/monitored_planning_scene": 4,
    "/object_pose": 10,
    "/tf": 20,
}


@pytest.fixture(scope="module")
def runs(recorded_run):
    names = ("arm_normal", "arm_payload", "arm_payload_shadow")
    return {name: recorded_run(name, campaign=CAMPAIGN) for name in names}


def messages(run, topic):
    with BagReader(run.bag) as bag:
        return [bag.deserialize(message) for message in bag.messages([topic])]


def column(run, topic, field):
    return np.array([getattr(message, field) for message in messages(run, topic)])


# -- kinematics and plans ------------------------------------------------------------------


@pytest.mark.parametrize(("x", "y", "yaw"), [(0.4, 0.3, 0.5), (0.6, -0.2, -1.2), (0.5, 0.0, 0.0)])
def test_joints_that_are_found_bring_the_tool_where_it_is_wanted(x, y, yaw):
    target = downward(x, y, 0.1, yaw)
    joints = solve(target, over(x, y))
    assert frames(joints)[-1] == pytest.approx(target, abs=1e-5)
    assert target[2, 3] == 0.1 + GRIP_M


def test_a_place_out_of_reach_has_no_joints():
    assert solve(downward(1.5, 0.0, 0.1, 0.0), over(1.5, 0.0)) is None


def test_kinematics_and_physics_agree(world):
    assert frames(np.array(HOME))[-1, :3, 3] == pytest.approx(world.tool(), abs=1e-9)


def test_a_path_leads_over_what_is_in_the_way_or_there_is_none():
    left, right = (solve(downward(0.5, y, 0.22, 0.0), over(0.5, y)) for y in (0.3, -0.3))
    low = np.array([[[0.5, 0.0, 0.15], [0.03, 0.03, 0.15]]])
    wall = np.array([[[0.5, 0.0, 0.5], [0.5, 0.01, 0.5]]])
    assert len(plan(left, right, low + np.array([[5.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))) == 2
    path = plan(left, right, low)
    assert len(path) == 4
    assert not any(touches(joints, low) for joints in along(path, 1.0, 1.0).positions)
    assert plan(left, right, wall) is None


def test_trajectories_keep_their_limits_and_survive_their_message():
    path = [np.array(HOME), np.array(HOME) + 0.7]
    trajectory = along(path, 0.5, 0.8)
    spline = from_message(trajectory.message(0))
    times = np.linspace(0.0, trajectory.times[-1], 1000)
    assert trajectory.times[-1] == pytest.approx(duration_s(0.7, 0.5, 0.8))
    assert np.abs(spline(times, 1)).max() <= 0.5 * 1.01
    assert np.abs(spline(times, 2)).max() <= 0.8 * 1.1
    assert spline(times[-1]) == pytest.approx(path[-1])


# -- the world and its conditions ----------------------------------------------------------


@pytest.fixture
def world():
    return World(recipe_for(find_mode("arm_normal"), 0, CAMPAIGN), np.random.default_rng(0))


def settled(world, conditions):
    """Mean of what is measured with conditions, after a second at rest."""
    for condition, value in conditions.items():
        world.change(condition, value)
    world.command(np.array(HOME), np.zeros(len(JOINTS)))
    world.advance_to(SECOND)
    rows = [np.concatenate(world.measure()) for _ in range(100)]
    return np.mean(rows, axis=0)


@pytest.mark.parametrize(
    ("condition", "values", "row"),
    [
        ("payload.mass_kg", (0.5, 1.0, 2.0), 15),  # effort of the shoulder's lift
        ("payload.mass_kg", (0.5, 1.0, 2.0), 23),  # force along the tool
        ("force.bias_x", (1.0, 5.0, 25.0), 21),
        ("torque.bias_z", (0.1, 0.5, 2.5), 26),
    ],
)
def test_what_is_measured_moves_with_the_magnitude_of_a_fault(condition, values, row):
    mode = find_mode("arm_normal")
    measured = [
        settled(World(recipe_for(mode, 0, CAMPAIGN), np.random.default_rng(0)), {condition: value})
        for value in (0.0, *values)
    ]
    moved = np.abs([each[row] - measured[0][row] for each in measured[1:]])
    assert moved == pytest.approx(moved[0] * np.array(values) / values[0], rel=0.1)


@pytest.mark.parametrize("offset", [0.01, 0.04])
def test_an_encoder_offset_moves_the_arm_and_not_its_joint_states(world, offset):
    before = world.tool()
    measured = settled(world, {"encoder.shoulder_pan": offset})
    assert measured[:6] == pytest.approx(HOME, abs=2e-3)
    radius = math.hypot(*before[:2])
    assert math.dist(world.tool(), before) == pytest.approx(offset * radius, rel=0.15)


# -- runs ----------------------------------------------------------------------------------


def test_a_normal_run_brings_the_object_to_its_place(runs):
    manifest = runs["arm_normal"].manifest()
    assert (manifest.outcome, manifest.contacts) == ("succeeded", ())
    last, place = messages(runs["arm_normal"], "/object_pose")[-1].pose, manifest.goals[0]
    assert math.hypot(last.position.x - place.x, last.position.y - place.y) < 0.02
    assert last.position.z == pytest.approx(0.04, abs=0.005)


def test_topics_types_and_qos_are_those_of_the_fact_table(runs):
    with BagReader(runs["arm_normal"].bag) as bag:
        held = {name: (topic.msgtype, *topic.qos) for name, topic in bag.topics.items()}
    assert FACTS.items() <= held.items()
    seconds = runs["arm_normal"].manifest().recording_s
    counts = runs["arm_normal"].manifest().topics
    assert {name: round(counts[name].messages / seconds) for name in RATES} == RATES


def test_transforms_follow_from_the_joint_states(runs):
    states = {(m.header.stamp.sec, m.header.stamp.nanosec): m.position[:6]
              for m in messages(runs["arm_normal"], "/joint_states")}  # fmt: skip
    for message in messages(runs["arm_normal"], "/tf")[::50]:
        stamp = message.transforms[0].header.stamp
        tool = np.eye(4)
        for each in message.transforms:
            tool = tool @ matrix(each.transform)
        assert tool == pytest.approx(frames(states[stamp.sec, stamp.nanosec])[-1], abs=1e-9)


def matrix(transform):
    x, y, z, w = (getattr(transform.rotation, name) for name in "xyzw")
    at = transform.translation
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), at.x],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), at.y],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), at.z],
        [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip


def test_a_fault_of_the_world_is_in_the_truth_and_in_no_message_or_graph(runs):
    normal, faulty, shadow = runs.values()
    assert faulty.manifest().topics["/parameter_events"].messages == 0
    changed = [truth for _, truth in read_ground_truth(faulty.bag) if truth.magnitude > 0.0]
    assert [truth.detail for truth in changed] == ["/world payload.mass_kg: 0 to 1"]
    assert graph_differences(read_intervals(normal.graphs), read_intervals(faulty.graphs)) == []
    with BagReader(normal.bag) as right, BagReader(shadow.bag) as computed:
        assert list(right.messages()) == list(computed.messages())


def test_fingers_without_friction_drop_the_object(recorded_run):
    run = recorded_run("arm_gripper_slip", campaign=CAMPAIGN, lost=1.0).manifest()
    assert run.outcome == "aborted"


def test_a_program_goes_on_after_a_goal_that_failed_with_a_large_force(recorded_run):
    four = Campaign(goals_per_run=4)
    run = recorded_run("arm_state_delay", campaign=four, seconds=0.6)
    assert [goal.outcome for goal in run.manifest().goal_results] == ["aborted"] * 4


@pytest.mark.parametrize("times", [1.5, 3.0])
def test_a_planner_with_wrong_limits_is_as_fast_as_they_are(recorded_run, runs, times):
    run = recorded_run("arm_speed_limit", campaign=CAMPAIGN, times=times)
    fastest, usual = (np.abs(column(each, "/joint_states", "velocity")[:, :6]).max()
                      for each in (run, runs["arm_normal"]))  # fmt: skip
    assert fastest > usual
    assert usual <= 0.5 * MAX_SPEED * 1.1 < fastest


@pytest.mark.parametrize("lost", [0.5, 1.0])
def test_velocities_are_lost_while_positions_move(recorded_run, lost):
    run = recorded_run("arm_zero_velocity", campaign=CAMPAIGN, lost=lost)
    onset = round(100 * run.manifest().onset_s)
    moved = np.gradient(column(run, "/joint_states", "position")[onset:, :6], 0.01, axis=0)
    shown = column(run, "/joint_states", "velocity")[onset:, :6]
    expected = (1.0 - lost) * np.abs(moved).max()
    assert np.abs(shown).max() == pytest.approx(expected, rel=0.1, abs=0.02)


def test_a_phantom_joins_the_planning_scene_and_lengthens_paths(recorded_run, runs):
    run = recorded_run("arm_phantom_object", campaign=CAMPAIGN, nearer=0.05)
    last = messages(run, "/monitored_planning_scene")[-1]
    assert {box.id for box in last.world.collision_objects} == {"object", "post", "phantom"}
    assert run.manifest().recording_s >= runs["arm_normal"].manifest().recording_s
