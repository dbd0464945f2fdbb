import numpy as np
import pytest

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import ActionClient, GoalStatus
from sim.nav2.costmap import LETHAL
from sim.nav2.costmap_node import GlobalCostmap
from sim.nav2.map_server import MapServer, OccupancyMap
from sim.nav2.messages import pose_stamped
from sim.nav2.paths import PATH, path_poses
from sim.nav2.planner_server import PlannerServer
from tests.sim.nav2.robot import IdealRobot

ACTION = "nav2_msgs/action/ComputePathToPose"
PoseGoal = message_class(f"{ACTION}_Goal")


def divided_room():
    """6 m by 4 m around the robot's start at (0, 0): a wall at x = 2 with a door at y = 1."""
    data = np.zeros((80, 120), np.int8)
    data[[0, -1], :] = data[:, [0, -1]] = 100
    data[:, 80] = 100
    data[50:70, 80] = 0
    return OccupancyMap(data, 0.05, (-2.0, -2.0))


class Rig:
    def __init__(self):
        self.robot = IdealRobot("/cmd_vel")
        domain = self.robot.domain
        self.costmap = GlobalCostmap(
            domain, self.robot.buffer, ["/scan"], rng=np.random.default_rng(1)
        )
        self.planner = PlannerServer(domain, self.costmap)
        server = MapServer(domain, divided_room())
        for node in (server, self.planner):
            node.configure()
        server.activate()
        assert not self.planner.activate()  # the map has not arrived yet
        self.robot.run(0.1)
        assert self.planner.activate()
        self.robot.run(0.1)
        self.plans = []
        self.robot.create_subscription(PATH, "/plan", self.plans.append, qos.RELIABLE)
        self.client = ActionClient(self.robot, ACTION, "/compute_path_to_pose")
        self.answers = []

    def ask(self, x, y, yaw=0.0, start=None):
        from_pose = self.stamped(*(start or (0.0, 0.0, 0.0)))
        goal = PoseGoal(self.stamped(x, y, yaw), from_pose, "GridBased", start is not None)
        return self.client.send_goal(goal, lambda *answer: self.answers.append(answer))

    def stamped(self, x, y, yaw):
        return pose_stamped(self.robot.now_ns, "map", x, y, yaw)

    def clear(self):
        name = "/global_costmap/clear_entirely_global_costmap"
        self.robot.create_client(name).call(None)
        self.robot.run(0.001)


@pytest.fixture
def rig():
    return Rig()


def test_path_goes_through_the_door_and_carries_the_goals_orientation_at_its_end_only(rig):
    rig.ask(3.0, -1.0, 0.7)
    rig.robot.run(0.001)
    ((status, result),) = rig.answers
    assert status is GoalStatus.SUCCEEDED
    poses = path_poses(result.path)
    assert result.path.header.frame_id == "map"
    assert poses[0, :2] == pytest.approx([0.0, 0.0], abs=0.05)
    assert poses[-1] == pytest.approx([3.0, -1.0, 0.7])
    assert not poses[:-1, 2].any()
    at_wall = poses[np.abs(poses[:, 0] - 2.025) < 0.05]
    assert np.all((at_wall[:, 1] > 0.5 + 0.22) & (at_wall[:, 1] < 1.5 - 0.22))


def test_plan_topic_shows_what_the_client_gets(rig):
    rig.ask(1.0, 1.0)
    rig.robot.run(0.001)
    assert rig.plans[0].header.stamp == rig.answers[0][1].path.header.stamp
    assert np.array_equal(path_poses(rig.plans[0]), path_poses(rig.answers[0][1].path))


def test_given_start_is_used_instead_of_the_robots_pose(rig):
    rig.ask(1.0, 1.0, start=(-1.0, 1.0, 0.0))
    rig.robot.run(0.001)
    poses = path_poses(rig.answers[0][1].path)
    assert poses[0, :2] == pytest.approx([-1.0, 1.0], abs=0.05)


@pytest.mark.parametrize("goal", [(9.0, 0.0), (3.0, 0.0)], ids=["off the map", "behind the wall"])
def test_unreachable_goal_aborts_and_publishes_nothing(rig, goal):
    rig.costmap.grid.costs[50:70, 80] = LETHAL  # shuts the door
    rig.ask(*goal)
    rig.robot.run(0.001)
    assert rig.answers == [(GoalStatus.ABORTED, None)]
    assert rig.plans == []


def test_cleared_costmap_is_not_planned_on_before_its_update(rig):
    rig.clear()
    rig.ask(3.0, 0.0)
    rig.robot.run(0.5)
    assert rig.answers == []
    rig.robot.run(0.6)
    assert rig.answers[0][0] is GoalStatus.SUCCEEDED


def test_goal_that_waits_can_be_cancelled_or_replaced(rig):
    rig.clear()
    cancelled = rig.ask(3.0, 0.0)
    rig.robot.run(0.05)
    cancelled.cancel()
    rig.robot.run(0.05)
    rig.ask(1.0, 1.0)
    rig.robot.run(0.05)
    rig.ask(1.0, -1.0)
    rig.robot.run(1.1)
    assert [status for status, _ in rig.answers] == [
        GoalStatus.CANCELED,
        GoalStatus.ABORTED,
        GoalStatus.SUCCEEDED,
    ]
    assert len(rig.plans) == 1
