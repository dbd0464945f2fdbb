import pytest

from oracle_pipeline.bags.types import message_class
from sim.middleware.action import ActionClient, ActionServer, Status
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND, Executor
from sim.middleware.node import Node
from sim.nav2.messages import pose_stamped
from sim.nav2.waypoint_follower import PAUSE_NS, WaypointFollower

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
            FollowWaypoints(poses), lambda status, result: self.ended.append((status, result))
        )


@pytest.fixture
def rig():
    return Rig()


def test_waypoints_are_visited_in_order_with_a_pause_and_missed_ones_are_named(rig):
    rig.follow([1.0, -2.0, 3.0])
    rig.domain.executor.run_until(10 * SECOND)
    assert [x for _, x in rig.visited] == [1.0, -2.0, 3.0]
    assert rig.visited[1][0] - rig.visited[0][0] == SECOND + PAUSE_NS
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
