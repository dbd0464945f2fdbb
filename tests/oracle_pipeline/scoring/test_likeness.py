"""Which recordings are of another kind of system than the reference."""

import pytest

from oracle_pipeline.scoring.contract import Contract, Observation
from oracle_pipeline.scoring.likeness import LEAST, likeness
from tests.oracle_pipeline.robots.recordings import (
    GRID,
    IMU,
    JOINTS,
    ODOMETRY,
    PATH,
    POSE,
    SCAN,
    TF,
    TWIST,
)

ROLES = {
    SCAN: "scan", ODOMETRY: "odometry", IMU: "imu", JOINTS: "joints", TWIST: "command",
    POSE: "pose", PATH: "plan", GRID: "map",
}  # fmt: skip
NAVIGATES = {
    "/scan": SCAN, "/odom": ODOMETRY, "/imu": IMU, "/joint_states": JOINTS, "/cmd_vel": TWIST,
    "/amcl_pose": POSE, "/plan": PATH, "/map": GRID, "/tf": TF,
    "/global_costmap": GRID, "/local_costmap": GRID, "/local_plan": PATH,
}  # fmt: skip
DRIVES = {name: NAVIGATES[name] for name in ("/scan", "/odom", "/cmd_vel", "/tf")}
SENSES = {"/imu/data": IMU, "/joint_states": JOINTS}
FLIES = {"/stateEstimate": "a/msg/A", "/controller": "a/msg/A"}
WATCHES = {name: f"atc_msgs/msg/{name[1:].title()}" for name in ("/adsb", "/radar", "/tracks")}
ROBOTS = (NAVIGATES, DRIVES, SENSES, FLIES, WATCHES)


def seen(topics):
    roles = {ROLES[kind]: (name,) for name, kind in topics.items() if kind in ROLES}
    return Observation({name: (kind, (), 5.0) for name, kind in topics.items()}, None, roles=roles)


def compared(usual, topics, numbers=((), ())):
    return likeness(Contract.learned([seen(usual)]), seen(topics), *numbers)


@pytest.mark.parametrize("robot", ROBOTS)
def test_other_names_or_one_topic_more_or_less_make_no_other_system(robot):
    assert compared(robot, robot).share == 1.0
    assert compared(robot, {f"/{name[1:][::-1]}": robot[name] for name in robot}).share > LEAST
    assert compared(robot, robot | {"/spy": SCAN}).share > LEAST
    (_, *rest) = robot
    assert compared(robot, {name: robot[name] for name in rest}).share > LEAST


@pytest.mark.parametrize("robot", ROBOTS)
def test_robots_of_other_kinds_are_other_systems(robot):
    others = [other for other in ROBOTS if other is not robot]
    assert all(compared(robot, other).share < LEAST for other in others)


def test_logs_of_one_name_and_type_are_told_apart_by_their_numbers():
    log = {"/log": "log_msgs/msg/Log"}
    drone, arm = (
        [f"signals./log/{field}.mean" for field in fields]
        for fields in (("roll", "pitch", "thrust"), ("torque", "current"))
    )
    assert compared(log, log, (drone, drone)).share == 1.0
    assert compared(log, log, (drone, arm)).share < LEAST
    assert compared(log, log, (drone, arm)).differences == ("Topic /log has other numbers.",)


def test_the_largest_differences_come_first():
    differences = compared(NAVIGATES, SENSES).differences
    assert differences[0].startswith("It lacks topics for the roles command, map, odometry")
    assert f"3 topics of type {GRID} are absent" in differences[1]
    assert len(differences) == 5
