import math

import numpy as np
import pytest

from oracle_pipeline.bags.types import message_class
from sim.middleware.action import ActionClient, GoalStatus
from sim.middleware.executor import SECOND
from sim.middleware.geometry import Pose2D
from sim.middleware.stamps import stamp_ns
from sim.nav2.controller_server import ControllerServer, GoalChecker, ProgressChecker
from sim.nav2.costmap_node import LocalCostmap
from sim.nav2.paths import PATH, path_bytes, path_message, path_poses
from tests.sim.nav2.robot import IdealRobot

FollowPath = message_class("nav2_msgs/action/FollowPath_Goal")
SpeedLimit = message_class("nav2_msgs/msg/SpeedLimit")


def test_progress_is_half_a_metre_in_ten_seconds():
    checker = ProgressChecker()
    assert checker.check(Pose2D(), 0)
    assert checker.check(Pose2D(0.49, 0.0), 10 * SECOND)
    assert not checker.check(Pose2D(0.5, 0.0), 10 * SECOND + 1)
    assert checker.check(Pose2D(0.51, 0.0), 10 * SECOND + 1)
    assert checker.check(Pose2D(0.51, 0.0), 20 * SECOND + 1)


def test_the_goal_is_near_within_a_quarter_of_a_metre_and_stays_so():
    checker = GoalChecker()
    goal = Pose2D(1.0, 0.0, 0.0)
    assert not checker.is_reached(Pose2D(0.74, 0.0, 0.0), goal)
    assert not checker.is_reached(Pose2D(0.76, 0.0, 1.0), goal)
    assert not checker.is_reached(Pose2D(0.5, 0.0, 0.26), goal)  # it was near
    assert checker.is_reached(Pose2D(0.5, 0.0, -0.25), goal)


class Rig(IdealRobot):
    """The robot, a controller server over a real costmap of an empty world, and a client."""

    def __init__(self, pose=None):
        super().__init__("/cmd_vel_nav", pose)
        rng = np.random.default_rng(0)
        costmap = LocalCostmap(self.domain, self.buffer, ["/scan"], rng=rng)
        self.server = ControllerServer(self.domain, costmap, self.buffer)
        self.server.configure()
        self.run(0.1)
        assert self.server.activate()
        self.client = ActionClient(self, "nav2_msgs/action/FollowPath", "/follow_path")
        self.ended = []  # (time, status)

    def follow(self, poses):
        path = path_message(self.now_ns, "map", np.array(poses, dtype=float))
        goal = FollowPath(path, "FollowPath", "")
        return self.client.send_goal(goal, lambda status, _: self.ended.append(status))

    def listen(self, topic, msgtype):
        heard = []
        self.create_subscription(msgtype, topic, heard.append)
        return heard


def line(length, yaw=0.0, end_yaw=None):
    along = np.arange(0.0, length + 1e-9, 0.025)
    poses = np.column_stack(
        [along * math.cos(yaw), along * math.sin(yaw), np.full(len(along), yaw)]
    )
    poses[-1, 2] = yaw if end_yaw is None else end_yaw
    return poses


@pytest.fixture
def rig():
    return Rig()


def test_a_straight_path_is_driven_to_its_end_without_weaving(rig):
    rig.follow(line(2.0))
    rig.run(15.0)
    assert rig.ended == [GoalStatus.SUCCEEDED]
    assert math.hypot(2.0 - rig.pose.x, rig.pose.y) <= 0.25
    assert abs(rig.pose.y) < 0.03
    assert rig.twists[-1][1:] == (0.0, 0.0)
    seconds = (rig.twists[-1][0] - rig.twists[0][0]) / SECOND
    assert seconds < 1.3 * 1.75 / 0.26


def test_it_turns_to_the_goals_yaw(rig):
    rig.follow(line(1.0, end_yaw=2.0))
    rig.run(20.0)
    assert rig.ended == [GoalStatus.SUCCEEDED]
    assert abs(rig.pose.yaw - 2.0) <= 0.25


def test_a_path_that_starts_behind_the_robot_is_reached_too():
    rig = Rig(Pose2D(yaw=math.pi - 0.1))
    rig.follow(line(1.5))
    rig.run(30.0)
    assert rig.ended == [GoalStatus.SUCCEEDED]


def test_commands_come_at_20_hz_from_the_moment_of_acceptance(rig):
    accepted_ns = rig.now_ns
    rig.follow(line(2.0))
    rig.run(1.0)
    times = [t for t, *_ in rig.twists]
    assert times == [accepted_ns + i * SECOND // 20 for i in range(21)]


def test_a_new_path_takes_over_without_a_stop(rig):
    rig.follow(line(2.0))
    rig.run(3.0)
    rig.follow(line(2.0, end_yaw=0.3))
    rig.run(1.0)
    assert rig.ended == [GoalStatus.ABORTED]
    assert all(linear > 0.1 for time, linear, _ in rig.twists if time > 2 * SECOND)
    rig.run(10.0)
    assert rig.ended == [GoalStatus.ABORTED, GoalStatus.SUCCEEDED]


def arrived_and_turning():
    """Return a rig that has arrived at (1, 0), turns, and is then localised 5 cm farther away."""
    rig = Rig()
    rig.follow(line(1.0, end_yaw=2.0))
    while rig.pose.yaw < 0.5:
        rig.run(0.05)
    rig.pose = Pose2D(rig.pose.x - 0.05, rig.pose.y, rig.pose.yaw)
    assert math.hypot(1.0 - rig.pose.x, rig.pose.y) > 0.25
    rig.twists.clear()
    return rig


def test_a_new_path_to_the_same_goal_does_not_make_a_robot_that_has_arrived_set_off_again():
    rig = arrived_and_turning()
    rig.follow(line(1.0, end_yaw=2.0))
    rig.run(5.0)
    assert rig.ended == [GoalStatus.ABORTED, GoalStatus.SUCCEEDED]
    assert {linear for _, linear, _ in rig.twists} == {0.0}


def test_a_new_path_to_another_goal_makes_the_robot_set_off_again():
    rig = arrived_and_turning()
    rig.follow(line(1.1, end_yaw=2.0))
    rig.run(10.0)
    assert rig.ended == [GoalStatus.ABORTED, GoalStatus.SUCCEEDED]
    assert math.hypot(1.1 - rig.pose.x, rig.pose.y) <= 0.25


def test_a_robot_that_was_stopped_on_arrival_starts_afresh():
    rig = arrived_and_turning()
    handle = rig.follow(line(1.0, end_yaw=2.0))
    rig.run(0.1)
    handle.cancel()
    rig.run(0.1)
    rig.follow(line(1.0, end_yaw=2.0))
    rig.run(10.0)
    assert rig.ended[-1] is GoalStatus.SUCCEEDED
    assert math.hypot(1.0 - rig.pose.x, rig.pose.y) <= 0.25


def test_a_robot_that_is_held_is_given_up_after_ten_seconds_even_with_new_paths(rig):
    rig.is_stuck = True
    started_ns = rig.now_ns
    for _ in range(9):
        rig.follow(line(2.0))
        rig.run(1.0)
    assert rig.ended == [GoalStatus.ABORTED] * 8  # each replaced by the next
    rig.run(2.0)
    assert len(rig.ended) == 9
    assert 10.0 < (rig.twists[-1][0] - started_ns) / SECOND <= 10.1
    assert rig.twists[-1][1:] == (0.0, 0.0)


def test_without_a_legal_velocity_it_halts_and_gives_up_after_0_3_s(rig):
    started_ns = rig.now_ns
    rig.follow(line(2.0) + np.array([9.0, 0.0, 0.0]))
    rig.run(1.0)
    assert rig.ended == [GoalStatus.ABORTED]
    assert {(linear, angular) for _, linear, angular in rig.twists} == {(0.0, 0.0)}
    assert 0.3 < (rig.twists[-1][0] - started_ns) / SECOND <= 0.4


def test_an_empty_path_is_refused(rig):
    rig.follow(np.empty((0, 3)))
    rig.run(0.1)
    assert rig.ended == [GoalStatus.ABORTED]


def test_cancelling_stops_the_robot(rig):
    handle = rig.follow(line(2.0))
    rig.run(2.0)
    handle.cancel()
    rig.run(0.1)
    assert rig.ended == [GoalStatus.CANCELED]
    assert rig.twists[-1][1:] == (0.0, 0.0)


def test_plans_go_out_with_every_cycle_in_their_frames(rig):
    topics = ("/received_global_plan", "/transformed_global_plan", "/local_plan")
    received, transformed, local = (rig.listen(topic, PATH) for topic in topics)
    sent_ns = rig.now_ns
    rig.follow(line(2.0))
    rig.run(1.0)
    assert (len(received), len(transformed), len(local)) == (22, 21, 21)
    assert stamp_ns(received[-1].header.stamp) == sent_ns
    assert [m[-1].header.frame_id for m in (received, transformed, local)] == [
        "map",
        "odom",
        "odom",
    ]
    assert path_poses(transformed[-1])[-1, 0] == pytest.approx(1.5 + rig.pose.x, abs=0.08)
    assert path_poses(local[-1])[0, 0] == pytest.approx(rig.pose.x, abs=0.03)


def test_the_received_plan_has_the_bytes_of_the_one_that_was_sent(rig):
    heard, path = [], line(2.0, end_yaw=0.06)  # a yaw that comes back from a quaternion changed
    rig.create_subscription(PATH, "/received_global_plan", heard.append, raw=True)
    sent = path_bytes(rig.now_ns, "map", path)
    rig.follow(path)
    rig.run(0.1)
    assert set(heard) == {sent}


def test_a_speed_limit_is_obeyed(rig):
    publisher = rig.create_publisher("nav2_msgs/msg/SpeedLimit", "/speed_limit")
    rig.follow(line(2.0))
    rig.run(1.0)
    assert rig.twists[-1][1] > 0.2
    publisher.publish(SpeedLimit(None, True, 50.0))
    rig.run(1.0)
    assert rig.twists[-1][1] <= 0.13
