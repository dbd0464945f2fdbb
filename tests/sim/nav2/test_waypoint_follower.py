import itertools

import pytest

from oracle_pipeline.bags.types import message_class
from sim.middleware.action import ActionClient, ActionServer, Status
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.node import Node
from sim.nav2.messages import pose_stamped
from sim.nav2.waypoint_follower import LOOP_NS, PAUSE_NS, WaypointFollower

FollowWaypoints = message_class("nav2_msgs/action/FollowWaypoints_Goal")


class Rig:
    """A follower, and a navigator that reaches every pose in 1 s but those with x < 0."""

    def __init__(self):
        self.domain = Domain(Executor())
        self.node = Node(self.domain, "/test")
        self.visited = []  # (time, x)
        ActionServer(
            self.node,
            "nav2_msgs/action/NavigateToPose",
            "/navigate_to_pose",
            self.navigate,
            lambda goal: goal.canceled(),
        )
        follower = WaypointFollower(self.domain)
        follower.configure()
        follower.activate()
        self.ended = []
        self.feedback = []  # (time, waypoint)

    def navigate(self, goal):
        x = goal.goal.pose.pose.position.x
        self.visited.append((self.node.now_ns, x))
        self.node.call_later(SECOND, self.arrive, goal, x)

    @staticmethod
    def arrive(goal, x):
        if goal.is_active:
            (goal.abort if x < 0.0 else goal.succeed)()

    def follow(self, xs):
        client = ActionClient(self.node, "nav2_msgs/action/FollowWaypoints", "/follow_waypoints")
        poses = [pose_stamped(0, "map", x, 0.0, 0.0) for x in xs]
        return client.send_goal(
            FollowWaypoints(poses),
            lambda status, result: self.ended.append((status, result)),
            lambda message: self.feedback.append((self.node.now_ns, message.current_waypoint)),
        )


@pytest.fixture
def rig():
    return Rig()


def test_waypoints_are_visited_in_order_and_missed_ones_are_named(rig):
    rig.follow([1.0, -2.0, 3.0])
    rig.domain.executor.run_until(10 * SECOND)
    assert [x for _, x in rig.visited] == [1.0, -2.0, 3.0]
    ((status, result),) = rig.ended
    assert status is Status.SUCCEEDED
    assert result.missed_waypoints.tolist() == [1]


def test_cancelling_ends_the_drive_to_the_current_waypoint(rig):
    handle = rig.follow([1.0, 2.0])
    rig.domain.executor.run_until(500 * MILLISECOND)
    handle.cancel()
    rig.domain.executor.run_until(10 * SECOND)
    assert [status for status, _ in rig.ended] == [Status.CANCELED]
    assert len(rig.visited) == 1


def test_there_is_a_pause_at_a_waypoint_that_was_reached_and_none_at_one_that_was_not(rig):
    rig.follow([1.0, -2.0, 3.0])
    rig.domain.executor.run_until(10 * SECOND)
    first, second, third = (time_ns for time_ns, _ in rig.visited)
    assert 0 <= second - first - SECOND - PAUSE_NS <= LOOP_NS
    assert 0 <= third - second - SECOND <= 2 * LOOP_NS


def test_feedback_names_the_waypoint_20_times_a_second(rig):
    rig.follow([1.0, 2.0])
    rig.domain.executor.run_until(SECOND // 2)
    assert {waypoint for _, waypoint in rig.feedback} == {0}
    times = [time_ns for time_ns, _ in rig.feedback]
    assert {later - earlier for earlier, later in itertools.pairwise(times)} == {LOOP_NS}


def test_a_new_list_takes_the_place_of_the_running_one(rig):
    rig.follow([1.0, 2.0])
    rig.domain.executor.run_until(SECOND // 2)
    rig.follow([5.0])
    rig.domain.executor.run_until(10 * SECOND)
    assert [x for _, x in rig.visited] == [1.0, 5.0]
    assert [status for status, _ in rig.ended] == [Status.ABORTED, Status.SUCCEEDED]


def test_an_empty_list_is_refused(rig):
    rig.follow([])
    rig.domain.executor.run_until(SECOND)
    assert [status for status, _ in rig.ended] == [Status.ABORTED]
    assert rig.visited == []
