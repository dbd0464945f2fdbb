import numpy as np
import pytest

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import ActionClient, GoalStatus
from sim.middleware.executor import SECOND
from sim.middleware.stamps import duration_message, stamp_ns
from sim.nav2.behavior_server import BehaviorServer
from sim.nav2.costmap import LETHAL, Costmap2D, costmap_message
from tests.sim.nav2.robot import IdealRobot

Point = message_class("geometry_msgs/msg/Point")
GOALS = {
    action: message_class(f"nav2_msgs/action/{action}_Goal")
    for action in ("Spin", "BackUp", "Wait")
}


class Rig(IdealRobot):
    """The robot, a behaviour server, its local costmap, and a client."""

    def __init__(self):
        super().__init__("/cmd_vel")
        self.grid = Costmap2D(np.zeros((60, 60), np.uint8), 0.05, -1.5, -1.5, "odom")
        self.costmap = self.create_publisher(
            "nav2_msgs/msg/Costmap", "/local_costmap/costmap_raw", qos.LATCHED
        )
        self.server = BehaviorServer(self.domain, self.buffer)
        self.server.configure()
        self.server.activate()
        self.publish_costmap()
        self.ended = []
        self.elapsed_ns = None

    def publish_costmap(self):
        self.costmap.publish(costmap_message(self.now_ns, self.grid))
        self.run(0.001)

    def do(self, name, action, *fields):
        client = ActionClient(self, f"nav2_msgs/action/{action}", f"/{name}")
        goal = GOALS[action](*fields)
        return client.send_goal(goal, self.on_result)

    def on_result(self, status, result):
        self.ended.append((status, self.now_ns / SECOND))
        self.elapsed_ns = stamp_ns(result.total_elapsed_time)


@pytest.fixture
def rig():
    return Rig()


def seconds(value):
    return duration_message(round(value * SECOND))


@pytest.mark.parametrize("angle", [1.57, -1.57])
def test_spin_turns_by_the_angle_at_1_rad_per_second_then_slower(rig, angle):
    rig.do("spin", "Spin", angle, seconds(10.0))
    rig.run(5.0)
    ((status, ended),) = rig.ended
    assert status is GoalStatus.SUCCEEDED
    assert 1.57 <= rig.pose.yaw * np.sign(angle) < 1.57 + 0.4 * 0.14
    assert 1.57 < ended < 2.5
    speeds = {round(abs(w), 6) for _, _, w in rig.twists[:-1]}
    assert max(speeds) == 1.0
    assert min(speeds) >= 0.4
    assert rig.twists[-1][1:] == (0.0, 0.0)


def test_backup_drives_back_whatever_the_signs_of_the_goal(rig):
    rig.do("backup", "BackUp", Point(0.30, 0.0, 0.0), 0.05, seconds(10.0))
    rig.run(10.0)
    assert [status for status, _ in rig.ended] == [GoalStatus.SUCCEEDED]
    assert rig.pose.x == pytest.approx(-0.30, abs=0.01)
    assert {v for _, v, _ in rig.twists[:-1]} == {-0.05}


def test_a_wall_behind_ends_a_backup_before_it_is_touched(rig):
    rig.grid.costs[:, :22] = LETHAL  # up to x = -0.4: the outline reaches to -0.23
    rig.publish_costmap()
    rig.do("backup", "BackUp", Point(0.30, 0.0, 0.0), 0.05, seconds(10.0))
    rig.run(10.0)
    assert [status for status, _ in rig.ended] == [GoalStatus.ABORTED]
    assert -0.17 < rig.pose.x < -0.05  # two seconds of 0.05 m/s ahead of the wall
    assert rig.twists[-1][1:] == (0.0, 0.0)


def test_a_behaviour_does_nothing_before_it_has_received_a_costmap():
    rig = IdealRobot("/cmd_vel")
    server = BehaviorServer(rig.domain, rig.buffer)
    server.configure()
    ended = []
    client = ActionClient(rig, "nav2_msgs/action/BackUp", "/backup")
    goal = GOALS["BackUp"](Point(0.3, 0.0, 0.0), 0.05, seconds(10.0))
    client.send_goal(goal, lambda status, _: ended.append(status))
    rig.run(1.0)
    assert ended == [GoalStatus.ABORTED]
    assert rig.pose.x == 0.0


def test_the_time_allowance_ends_a_behaviour_of_a_robot_that_is_held(rig):
    rig.is_stuck = True
    rig.do("spin", "Spin", 1.57, seconds(3.0))
    rig.run(5.0)
    ((status, ended),) = rig.ended
    assert status is GoalStatus.ABORTED
    assert ended == pytest.approx(3.1, abs=0.01)


def test_wait_waits_and_sends_nothing(rig):
    started = rig.now_ns / SECOND
    rig.do("wait", "Wait", seconds(5.0))
    rig.run(6.0)
    ((status, ended),) = rig.ended
    assert status is GoalStatus.SUCCEEDED
    assert ended - started == pytest.approx(5.0)
    assert rig.twists == []
    assert rig.elapsed_ns == 5 * SECOND


def test_cancelling_stops_the_robot(rig):
    handle = rig.do("spin", "Spin", 6.0, seconds(10.0))
    rig.run(1.0)
    handle.cancel()
    rig.run(0.2)
    assert [status for status, _ in rig.ended] == [GoalStatus.CANCELED]
    assert rig.twists[-1][1:] == (0.0, 0.0)
    assert rig.elapsed_ns == pytest.approx(SECOND, abs=0.1 * SECOND)


def test_a_second_goal_ends_both_as_in_nav2(rig):
    rig.do("spin", "Spin", 6.0, seconds(10.0))
    rig.run(1.0)
    rig.do("spin", "Spin", 6.0, seconds(10.0))
    rig.run(0.2)
    assert [status for status, _ in rig.ended] == [GoalStatus.ABORTED, GoalStatus.ABORTED]


def test_five_publishers_reach_the_wheels_directly(rig):
    mine = [p for p in rig.domain.publishers("/cmd_vel") if p.node == "/behavior_server"]
    assert len(mine) == 5
