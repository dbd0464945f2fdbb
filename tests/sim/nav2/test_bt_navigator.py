"""The navigation tree among scripted servers: order of recoveries, replanning, results, log."""

import itertools

import numpy as np
import pytest

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import ActionClient, ActionServer, GoalStatus
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.middleware.stamps import stamp_ns
from sim.nav2.basic_navigator import BasicNavigator
from sim.nav2.bt_navigator import BtNavigator
from sim.nav2.messages import TWIST, pose_stamped, twist_message
from sim.nav2.paths import path_message, path_poses
from tests.sim.nav2.robot import IdealRobot

NavigateToPose = message_class("nav2_msgs/action/NavigateToPose_Goal")
PathResult = message_class("nav2_msgs/action/ComputePathToPose_Result")

ACTIONS = {
    "compute_path_to_pose": "ComputePathToPose",
    "follow_path": "FollowPath",
    "spin": "Spin",
    "wait": "Wait",
    "backup": "BackUp",
}


class Rig(IdealRobot):
    """A navigator and scripted servers.

    ``script[name]`` is called with a goal handle. By default plans are found, paths are followed
    indefinitely, and recoveries succeed at once. ``calls`` records all requests with their times.
    """

    def __init__(self):
        super().__init__("/cmd_vel")
        self.calls = []
        self.script = {
            "compute_path_to_pose": self.plan,
            "follow_path": self.follow,
            "spin": lambda goal: goal.succeed(),
            "wait": lambda goal: goal.succeed(),
            "backup": lambda goal: goal.succeed(),
        }
        self.following = []
        servers = Node(self.domain, "/servers")
        for name, action in ACTIONS.items():
            ActionServer(
                servers,
                f"nav2_msgs/action/{action}",
                f"/{name}",
                lambda goal, name=name: self.asked(name, goal),
                lambda goal: goal.canceled(),
            )
        for costmap in ("local", "global"):
            servers.create_service(
                "nav2_msgs/srv/ClearEntireCostmap",
                f"/{costmap}_costmap/clear_entirely_{costmap}_costmap",
                lambda _, costmap=costmap: self.calls.append((f"clear {costmap}", self.now_ns)),
            )
        self.navigator = BtNavigator(self.domain, self.buffer)
        self.navigator.configure()
        self.navigator.activate()
        self.client = ActionClient(self, "nav2_msgs/action/NavigateToPose", "/navigate_to_pose")
        self.log = []
        self.create_subscription(
            "nav2_msgs/msg/BehaviorTreeLog",
            "/behavior_tree_log",
            lambda m: self.log.extend(
                (e.node_name, e.previous_status, e.current_status) for e in m.event_log
            ),
        )
        self.ended = []
        self.feedback = []

    def asked(self, name, goal):
        self.calls.append((name, self.now_ns))
        self.script[name](goal)

    def plan(self, goal):
        end = goal.goal.goal.pose.position.x
        poses = np.column_stack([np.linspace(0.0, end, 41), np.zeros(41), np.zeros(41)])
        goal.succeed(PathResult(path_message(self.now_ns, "map", poses), None))

    def follow(self, goal):
        for replaced in self.following:
            replaced.abort()
        self.following = [goal]

    def arrive(self):
        self.following.pop().succeed()

    def go(self, x=1.0):
        return self.client.send_goal(
            NavigateToPose(pose_stamped(self.now_ns, "map", x, 0.0, 0.0), ""),
            lambda status, _: self.ended.append(status),
            self.feedback.append,
        )

    def names(self, *, but=()):
        return [name for name, _ in self.calls if name not in but]


@pytest.fixture
def rig():
    return Rig()


def abort(goal):
    goal.abort()


def test_a_goal_is_planned_followed_and_reached(rig):
    rig.go()
    rig.run(0.5)
    assert rig.names() == ["compute_path_to_pose", "follow_path"]
    rig.arrive()
    rig.run(0.1)
    assert rig.ended == [GoalStatus.SUCCEEDED]


def test_it_replans_once_a_second_and_forwards_every_new_path(rig):
    rig.go()
    rig.run(5.5)
    planned = [t for name, t in rig.calls if name == "compute_path_to_pose"]
    assert len(planned) == 6
    # The period counts from the plan's success, which is noticed a tick after its request.
    assert np.diff(planned) == pytest.approx(np.full(5, 1.01 * SECOND))
    assert rig.names().count("follow_path") == 6


def test_recoveries_come_in_turn_and_after_six_of_them_the_goal_is_aborted(rig):
    rig.script["follow_path"] = abort
    rig.go()
    rig.run(10.0)
    assert rig.ended == [GoalStatus.ABORTED]
    attempt = ["follow_path", "clear local", "follow_path"]  # one retry after a context clear
    recoveries = [["clear local", "clear global"], ["spin"], ["wait"], ["backup"]]
    expected = attempt.copy()
    for i in range(6):
        expected += recoveries[i % 4] + attempt
    assert rig.names(but=["compute_path_to_pose"]) == expected
    clears_and_motions = [n for n in expected if n != "follow_path"]
    assert rig.navigator.number_of_recoveries == len(clears_and_motions)
    assert rig.feedback[-1].number_of_recoveries == len(clears_and_motions)


def test_the_round_robin_keeps_its_place_from_goal_to_goal(rig):
    rig.script["follow_path"] = abort
    rig.go()
    rig.run(10.0)  # the six recoveries end with a spin, after which a wait is due
    rig.calls.clear()
    rig.go()
    rig.run(10.0)
    motions = [n for n in rig.names() if n in ("spin", "wait", "backup")]
    assert motions[0] == "wait"


def test_without_a_plan_the_global_costmap_is_cleared_and_nothing_is_followed(rig):
    rig.script["compute_path_to_pose"] = abort
    rig.go()
    rig.run(10.0)
    assert rig.ended == [GoalStatus.ABORTED]
    assert rig.names()[:4] == [
        "compute_path_to_pose",
        "clear global",
        "compute_path_to_pose",
        "clear local",  # the first recovery
    ]
    assert "follow_path" not in rig.names()


def test_one_failure_is_healed_by_the_context_clear_alone(rig):
    rig.script["follow_path"] = abort
    rig.go()
    rig.script["follow_path"] = lambda goal: (
        abort(goal) if rig.names().count("follow_path") == 1 else rig.follow(goal)
    )
    rig.run(0.5)
    rig.arrive()
    rig.run(0.1)
    assert rig.ended == [GoalStatus.SUCCEEDED]
    assert rig.names() == ["compute_path_to_pose", "follow_path", "clear local", "follow_path"]
    assert rig.navigator.number_of_recoveries == 1


def test_cancelling_stops_what_is_under_way(rig):
    handle = rig.go()
    rig.run(0.5)
    handle.cancel()
    rig.run(0.1)
    assert rig.ended == [GoalStatus.CANCELED]
    assert rig.following[0].status is GoalStatus.CANCELED
    rig.calls.clear()
    rig.run(3.0)
    assert rig.calls == []


def test_a_new_goal_replaces_the_old_one_and_is_planned_for_within_a_second(rig):
    rig.go(1.0)
    rig.run(0.5)
    rig.go(2.0)
    rig.run(1.0)
    assert rig.ended == [GoalStatus.ABORTED]
    assert rig.following[0].goal.path.poses[-1].pose.position.x == 2.0
    rig.arrive()
    rig.run(0.1)
    assert rig.ended == [GoalStatus.ABORTED, GoalStatus.SUCCEEDED]


def test_a_new_goal_interrupts_a_recovery(rig):
    rig.script["follow_path"] = abort
    held = []
    rig.script["spin"] = held.append
    rig.go(1.0)
    rig.run(1.0)
    assert held[0].status is GoalStatus.EXECUTING
    rig.script["follow_path"] = rig.follow
    rig.go(2.0)
    rig.run(0.5)
    assert held[0].status is GoalStatus.CANCELED
    assert rig.following[0].goal.path.poses[-1].pose.position.x == 2.0


def test_the_log_names_the_trees_nodes_and_every_change_starts_where_the_last_one_ended(rig):
    rig.script["follow_path"] = abort
    rig.go()
    rig.run(10.0)
    assert {name for name, _, _ in rig.log} == {
        "NavigateRecovery",
        "NavigateWithReplanning",
        "RateController",
        "ComputePathToPose",
        "FollowPath",
        "ClearLocalCostmap-Context",
        "RecoveryFallback",
        "GoalUpdated",
        "RecoveryActions",
        "ClearingActions",
        "ClearLocalCostmap-Subtree",
        "ClearGlobalCostmap-Subtree",
        "Spin",
        "Wait",
        "BackUp",
    }
    for node in ("NavigateRecovery", "RateController", "Spin"):  # names that only one node has
        changes = [(before, after) for name, before, after in rig.log if name == node]
        assert changes[0][0] == "IDLE"
        assert all(a[1] == b[0] for a, b in itertools.pairwise(changes))


def test_a_replan_logs_a_short_burst(rig):
    rig.go()
    rig.run(0.5)
    rig.log.clear()
    rig.run(1.0)
    assert ("RateController", "RUNNING", "SUCCESS") in rig.log
    assert len(rig.log) <= 12


def test_feedback_has_the_remaining_distance(rig):
    rig.go(1.0)
    rig.run(0.5)
    last = rig.feedback[-1]
    assert last.distance_remaining == pytest.approx(1.0)
    assert last.number_of_recoveries == 0
    assert last.current_pose.header.frame_id == "map"


def test_the_time_that_remains_is_that_of_the_distance_at_the_present_speed(rig):
    wheels = rig.create_publisher(TWIST, "/cmd_vel")
    rig.go(1.0)
    wheels.publish(twist_message(0.2, 0.0))
    rig.run(2.5)
    last = rig.feedback[-1]
    assert last.distance_remaining == pytest.approx(1.0 - rig.pose.x, abs=0.13)  # up to 0.5 s ago
    assert stamp_ns(last.estimated_time_remaining) == pytest.approx(
        last.distance_remaining / 0.2 * SECOND
    )
    assert 2.0 * SECOND <= stamp_ns(last.navigation_time) <= 2.5 * SECOND
    wheels.publish(twist_message(0.0, 0.0))
    rig.run(1.5)
    assert stamp_ns(rig.feedback[-1].estimated_time_remaining) == 0


def test_feedback_has_100_hz_if_the_hidden_topic_has_a_subscriber(rig):
    heard = []
    rig.create_subscription(
        "nav2_msgs/action/NavigateToPose_FeedbackMessage",
        "/navigate_to_pose/_action/feedback",
        lambda m: heard.append((rig.now_ns, m)),
    )
    rig.go()
    rig.run(1.0)
    assert len(heard) == 101
    assert set(np.diff([t for t, _ in heard])) == {10 * MILLISECOND}


def test_a_pose_on_goal_pose_is_a_goal(rig):
    publisher = rig.create_publisher("geometry_msgs/msg/PoseStamped", "/goal_pose")
    publisher.publish(pose_stamped(rig.now_ns, "map", 1.5, 0.0, 0.0))
    rig.run(0.5)
    assert rig.following[0].goal.path.poses[-1].pose.position.x == 1.5


# -- the client ----------------------------------------------------------------------------


class Patrol(Rig):
    """A patrol of three goals; a path takes 0.9 s to follow."""

    def __init__(self):
        super().__init__()
        self.client = BasicNavigator(self.domain)
        self.ends = []  # of the paths
        self.script["follow_path"] = self.arrive_later

    def arrive_later(self, goal):
        self.ends.append(path_poses(goal.goal.path)[-1, 0])
        self.follow(goal)
        self.call_later(900 * MILLISECOND, self.arrive_if_current, goal)

    def arrive_if_current(self, goal):
        if goal in self.following:
            self.arrive()

    def start(self):
        goals = [Pose2D(x) for x in (1.0, 2.0, 3.0)]
        self.client.follow(goals)

    def complete(self):
        self.domain.executor.run_until(12 * SECOND, stop=lambda: self.client.is_over)


def test_a_patrol_sends_its_goals_one_after_the_other():
    rig = Patrol()
    rig.start()
    rig.complete()
    results = rig.client.results
    assert [r.outcome for r in results] == ["succeeded"] * 3
    assert list(dict.fromkeys(rig.ends)) == [1.0, 2.0, 3.0]
    assert results[1].accepted_ns == results[0].ended_ns
    assert rig.client.is_over
    assert rig.now_ns == results[2].ended_ns


def test_a_patrol_ends_with_the_first_goal_that_is_not_reached():
    rig = Patrol()
    rig.start()
    rig.run(0.5)
    rig.script["follow_path"] = abort  # from the second goal on
    rig.run(10.0)
    results = rig.client.results
    assert [r.outcome for r in results] == ["succeeded", "aborted"]
    assert results[0].number_of_recoveries == 0
    assert results[1].number_of_recoveries == rig.navigator.number_of_recoveries > 6
    assert rig.client.is_over


def test_the_initial_pose_is_published_every_second_until_amcl_answers(rig):
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    poses = []
    rig.create_subscription(kind, "/initialpose", lambda m: poses.append(m))
    client = BasicNavigator(rig.domain)
    client.set_initial_pose(Pose2D(-2.0, -0.5, 0.1))
    rig.run(2.5)
    assert len(poses) == 3
    assert poses[0].pose.pose.position.x == -2.0
    rig.create_publisher(kind, "/amcl_pose", qos.LATCHED).publish(poses[0])
    rig.run(3.0)
    assert len(poses) == 3
