import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import ActionClient, Status
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.middleware.node import Node
from sim.nav2.costmap import LETHAL, Costmap2D, costmap_message
from sim.nav2.costmap_node import GlobalCostmap
from sim.nav2.map_server import MapServer, OccupancyMap
from sim.nav2.messages import pose_stamped
from sim.nav2.paths import PATH, path_message, path_poses
from sim.nav2.planner_server import PlannerServer
from sim.nav2.smoother_server import DATA_WEIGHT, SMOOTH_WEIGHT, SmootherServer, smooth
from tests.sim.nav2.robot import IdealRobot

ACTION = "nav2_msgs/action/ComputePathToPose"
THROUGH = "nav2_msgs/action/ComputePathThroughPoses"
SMOOTH = "nav2_msgs/action/SmoothPath"
PoseGoal = message_class(f"{ACTION}_Goal")
PosesGoal = message_class(f"{THROUGH}_Goal")
SmoothGoal = message_class(f"{SMOOTH}_Goal")
Duration = message_class("builtin_interfaces/msg/Duration")


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
            domain, "000000000001", ["/scan"], rng=np.random.default_rng(1)
        )
        self.planner = PlannerServer(domain, self.costmap)
        server = MapServer(domain, {"map": divided_room()}, "map")
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
        self.through = ActionClient(self.robot, THROUGH, "/compute_path_through_poses")
        self.answers = []

    def ask(self, x, y, yaw=0.0, start=None):
        from_pose = self.stamped(*(start or (0.0, 0.0, 0.0)))
        goal = PoseGoal(self.stamped(x, y, yaw), from_pose, "GridBased", start is not None)
        return self.client.send_goal(goal, lambda *answer: self.answers.append(answer))

    def stamped(self, x, y, yaw):
        return pose_stamped(self.robot.now_ns, "map", x, y, yaw)

    def clear(self):
        name = "/global_costmap/clear_entirely_global_costmap"
        self.robot.create_client("nav2_msgs/srv/ClearEntireCostmap", name).call(None)
        self.robot.run(0.001)


@pytest.fixture
def rig():
    return Rig()


def test_path_goes_through_the_door_and_carries_the_goals_orientation_at_its_end_only(rig):
    rig.ask(3.0, -1.0, 0.7)
    rig.robot.run(0.001)
    ((status, result),) = rig.answers
    assert status is Status.SUCCEEDED
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
    assert rig.answers == [(Status.ABORTED, None)]
    assert rig.plans == []


def test_cleared_costmap_is_not_planned_on_before_its_update(rig):
    rig.clear()
    rig.ask(3.0, 0.0)
    rig.robot.run(0.5)
    assert rig.answers == []
    rig.robot.run(0.6)
    assert rig.answers[0][0] is Status.SUCCEEDED


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
        Status.CANCELED,
        Status.ABORTED,
        Status.SUCCEEDED,
    ]
    assert len(rig.plans) == 1


def test_path_through_poses_visits_them_in_order(rig):
    goals = [rig.stamped(1.0, 1.0, 0.5), rig.stamped(3.0, 1.0, -0.5), rig.stamped(3.0, -1.0, 0.1)]
    goal = PosesGoal(goals, goals[0], "GridBased", False)
    rig.through.send_goal(goal, lambda *answer: rig.answers.append(answer))
    rig.robot.run(0.001)
    ((status, result),) = rig.answers
    assert status is Status.SUCCEEDED
    poses = path_poses(result.path)
    turned = poses[poses[:, 2] != 0.0]
    assert turned == pytest.approx(np.array([[1, 1, 0.5], [3, 1, -0.5], [3, -1, 0.1]]))


def test_path_is_valid_until_something_stands_on_it(rig):
    rig.ask(1.0, 0.0)
    rig.robot.run(0.001)
    path = rig.answers[0][1].path
    answers = []
    client = rig.robot.create_client("nav2_msgs/srv/IsPathValid", "/is_path_valid")
    client.call(path, answers.append)
    rig.robot.run(0.001)
    column, row = rig.costmap.grid.cell(0.5, 0.0)
    rig.costmap.grid.costs[row - 1 : row + 2, column] = LETHAL
    client.call(path, answers.append)
    rig.robot.run(0.001)
    assert answers == [True, False]


# -- smoother --------------------------------------------------------------------------------

paths = hnp.arrays(np.float64, st.tuples(st.integers(2, 8), st.just(2)), elements=st.floats(-5, 5))


def sweep_until_nothing_moves(original):
    """Nav2's simple smoother, point by point (tolerance 1e-10)."""
    points, change = original.copy(), 1.0
    while change > 1e-10:
        before = points.copy()
        for i in range(1, len(points) - 1):
            points[i] += DATA_WEIGHT * (original[i] - points[i])
            points[i] += SMOOTH_WEIGHT * (points[i - 1] + points[i + 1] - 2.0 * before[i])
        change = np.abs(points - before).sum()
    return points


@given(paths)
def test_smoothing_and_its_four_refinements_end_where_nav2s_sweeps_would(points):
    expected = points
    for _ in range(5):
        expected = sweep_until_nothing_moves(expected)
    assert smooth(points) == pytest.approx(expected, abs=1e-8)


def test_the_corner_of_three_known_points():
    # Each pass leaves 0.2 / 0.8 of the corner's distance from the middle between its neighbours.
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    assert smooth(corner)[1] == pytest.approx([0.5 + 0.5 / 4**5, 0.5 - 0.5 / 4**5])


@pytest.mark.parametrize("is_blocked", [False, True])
def test_smoother_answers_and_keeps_the_path_where_the_smooth_one_collides(is_blocked):
    executor = Executor()
    domain = Domain(executor)
    server = SmootherServer(domain, "000000000001")
    server.configure()
    server.activate()
    client = Node(domain, "/client")
    raw = client.create_publisher(
        "nav2_msgs/msg/Costmap", "/global_costmap/costmap_raw", qos.LATCHED
    )
    corner = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    grid = Costmap2D(np.zeros((40, 40), np.uint8), 0.05, -0.5, -0.5, "map")
    if is_blocked:
        column, row = grid.cell(*smooth(corner[:, :2])[1])
        grid.costs[row, column] = LETHAL
    raw.publish(costmap_message(0, grid))
    answers = []
    goal = SmoothGoal(path_message(0, "map", corner), "simple_smoother", Duration(1, 0), True)
    ActionClient(client, SMOOTH, "/smooth_path").send_goal(goal, lambda *a: answers.append(a))
    executor.run_until(SECOND)
    ((status, result),) = answers
    assert status is Status.SUCCEEDED
    assert result.was_completed is not is_blocked
    expected = corner[:, :2] if is_blocked else smooth(corner[:, :2])
    assert path_poses(result.path)[:, :2] == pytest.approx(expected)
