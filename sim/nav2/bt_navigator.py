"""The navigator: drives the robot to a pose by ticking a behaviour tree.

The tree is ``navigate_to_pose_w_replanning_and_recovery.xml`` of Nav2 on Humble. Nav2 ticks it
at 100 Hz; here it is ticked on the same grid of 10 ms, but only while something changes.
"""

from collections.abc import Callable
from typing import Any

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import ActionClient, GoalHandle, GoalStatus
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import duration_message, time_message
from sim.middleware.tf import TransformBuffer, TransformError
from sim.nav2 import actions, behavior_tree
from sim.nav2.actions import SimpleActionServer
from sim.nav2.behavior_tree_leaves import ActionNode, Condition, ServiceNode
from sim.nav2.lifecycle import LifecycleNode
from sim.nav2.messages import pose_stamped
from sim.nav2.paths import Poses, length_ahead, path_poses

_BackUp = message_class("nav2_msgs/action/BackUp_Goal")
_BehaviorTreeLog = message_class("nav2_msgs/msg/BehaviorTreeLog")
_BehaviorTreeStatusChange = message_class("nav2_msgs/msg/BehaviorTreeStatusChange")
_ComputePath = message_class("nav2_msgs/action/ComputePathToPose_Goal")
_Feedback = message_class("nav2_msgs/action/NavigateToPose_Feedback")
_FollowPath = message_class("nav2_msgs/action/FollowPath_Goal")
_NavigateToPose = message_class("nav2_msgs/action/NavigateToPose_Goal")
_Point = message_class("geometry_msgs/msg/Point")
_Spin = message_class("nav2_msgs/action/Spin_Goal")
_Wait = message_class("nav2_msgs/action/Wait_Goal")

GLOBAL_FRAME = "map"
BASE_FRAME = "base_link"
TICK_NS = 10 * MILLISECOND
REPLAN_PERIOD_NS = 1 * SECOND
RETRIES = 6
SPIN_RAD = 1.57
WAIT_NS = 5 * SECOND
BACK_UP_M = 0.30
BACK_UP_SPEED = 0.05  # [m/s]
TIME_ALLOWANCE_NS = 10 * SECOND  # of spinning and backing up
_TF_STATIC = qos.profile(100, latched=True)


class _RclcppNode(Node):
    """The node that a navigator makes for its tree: log, clients of actions and services.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    navigator
        ``navigate_to_pose`` or ``navigate_through_poses``.
    planner_action
        The planner's action that the tree calls.
    """

    def __init__(self, domain: Domain, navigator: str, planner_action: str) -> None:
        super().__init__(domain, f"/bt_navigator_{navigator}_rclcpp_node")
        self.log = self.create_publisher("nav2_msgs/msg/BehaviorTreeLog", "/behavior_tree_log")
        names = planner_action, "follow_path", "spin", "wait", "backup"
        self.plan, self.follow, self.spin, self.wait, self.back_up = (
            actions.client(self, name) for name in names
        )
        self.clear_local, self.clear_global = (
            self.create_client(f"/{costmap}/clear_entirely_{costmap}")
            for costmap in ("local_costmap", "global_costmap")
        )


class BtNavigator(LifecycleNode):
    """Serves ``/navigate_to_pose``, and takes goals from ``/goal_pose`` as well.

    Parameters
    ----------
    domain, latency_ns
        As for `LifecycleNode`.
    transforms
        Transforms.

    Attributes
    ----------
    number_of_recoveries
        Spins, waits, back-ups and costmap clearings for the current goal.
    """

    def __init__(self, domain: Domain, transforms: TransformBuffer, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/bt_navigator", latency_ns=latency_ns)
        self._transforms = transforms
        self.number_of_recoveries = 0
        self._plan_goal: Any = None
        self._follow_goal: Any = None
        self._goal_updated = False
        self._path: Poses | None = None
        self._start_ns = 0  # of the grid of ticks
        self._goal_ns = 0
        self._due: set[int] = set()  # when the tree is to be ticked
        self._changes: list[Any] = []  # status changes since the last log
        self._speed = 0.0

    def on_configure(self) -> None:
        """Make the tree, its nodes, and the endpoints."""
        self.create_subscription("tf2_msgs/msg/TFMessage", "/tf", None, qos.TF)
        self.create_subscription("tf2_msgs/msg/TFMessage", "/tf_static", None, _TF_STATIC)
        self.create_subscription("nav_msgs/msg/Odometry", "/odom", self._on_odometry, qos.SYSTEM)
        self.create_subscription(
            "geometry_msgs/msg/PoseStamped", "/goal_pose", self._on_goal_pose, qos.SYSTEM
        )
        self._goals = SimpleActionServer(self, "navigate_to_pose", self._start, self._wake)
        actions.leave_unserved(self, ["navigate_through_poses"])
        self._client = actions.client(self, "navigate_to_pose")
        self._node = _RclcppNode(self.domain, "navigate_to_pose", "compute_path_to_pose")
        _RclcppNode(self.domain, "navigate_through_poses", "compute_path_through_poses")
        self._tree = self._make_tree()
        for node in self._tree.walk():
            node.on_change = self._on_change

    # -- the tree --------------------------------------------------------------------------

    def _make_tree(self) -> behavior_tree.TreeNode:
        allowance = duration_message(TIME_ALLOWANCE_NS)
        spin = _Spin(SPIN_RAD, allowance)
        wait = _Wait(duration_message(WAIT_NS))
        back_up = _BackUp(_Point(BACK_UP_M, 0.0, 0.0), BACK_UP_SPEED, allowance)
        plan = ActionNode(
            "ComputePathToPose",
            self._node.plan,
            lambda: self._plan_goal,
            self._wake,
            on_success=self._on_path,
        )
        follow = ActionNode("FollowPath", self._node.follow, lambda: self._follow_goal, self._wake)
        navigate = behavior_tree.PipelineSequence(
            "NavigateWithReplanning",
            [
                behavior_tree.RateController(
                    behavior_tree.RecoveryNode(
                        "ComputePathToPose", plan, self._clear("Global", "Context"), retries=1
                    ),
                    REPLAN_PERIOD_NS,
                    lambda: self.now_ns,
                    self._wake_at,
                ),
                behavior_tree.RecoveryNode(
                    "FollowPath", follow, self._clear("Local", "Context"), retries=1
                ),
            ],
        )
        recover = behavior_tree.RoundRobin(
            "RecoveryActions",
            [
                behavior_tree.SequenceNode(
                    "ClearingActions",
                    [self._clear("Local", "Subtree"), self._clear("Global", "Subtree")],
                ),
                self._recovery("Spin", self._node.spin, spin),
                self._recovery("Wait", self._node.wait, wait),
                self._recovery("BackUp", self._node.back_up, back_up),
            ],
        )
        updated = Condition("GoalUpdated", self._is_goal_updated)
        fallback = behavior_tree.ReactiveFallback("RecoveryFallback", [updated, recover])
        return behavior_tree.RecoveryNode("NavigateRecovery", navigate, fallback, RETRIES)

    def _recovery(self, name: str, client: ActionClient, goal: Any) -> ActionNode:
        return ActionNode(name, client, lambda: goal, self._wake, on_start=self._count_recovery)

    def _clear(self, costmap: str, place: str) -> ServiceNode:
        client = self._node.clear_local if costmap == "Local" else self._node.clear_global
        name = f"Clear{costmap}Costmap-{place}"
        return ServiceNode(name, client, self._count_recovery, self._wake)

    def _count_recovery(self) -> None:
        self.number_of_recoveries += 1

    def _is_goal_updated(self) -> bool:
        updated, self._goal_updated = self._goal_updated, False
        return updated

    def _on_path(self, result: Any) -> None:
        self._follow_goal = _FollowPath(result.path, "FollowPath", "")
        self._path = path_poses(result.path)

    def _on_change(
        self,
        node: behavior_tree.TreeNode,
        previous: behavior_tree.NodeStatus,
        status: behavior_tree.NodeStatus,
    ) -> None:
        stamp = time_message(self.now_ns)
        self._changes.append(
            _BehaviorTreeStatusChange(stamp, node.name, previous.name, status.name)
        )

    # -- goals -----------------------------------------------------------------------------

    def _on_goal_pose(self, pose: Any) -> None:
        self._client.send_goal(_NavigateToPose(pose, ""), lambda *_: None)

    def _start(self) -> None:
        self._start_ns = self.now_ns
        self._take_goal()
        self._goal_updated = False
        self._tick()

    def _take_goal(self) -> None:
        pose = self._goals.current.goal.pose
        self.info(
            "Begin navigating from current location to "
            f"({pose.pose.position.x:.2f}, {pose.pose.position.y:.2f})"
        )
        self._goal_ns = self.now_ns
        self._goal_updated = True
        self.number_of_recoveries = 0
        # Without a start pose the planner begins where the robot is.
        self._plan_goal = _ComputePath(pose, pose, "GridBased", use_start=False)
        self._path = None

    def _end(self, answer: Callable[[GoalHandle], None], text: str) -> None:
        self._due.clear()
        self._tree.halt()
        self.info(text)
        self._goals.end(answer)

    # -- ticking ---------------------------------------------------------------------------

    def _wake(self) -> None:
        self._wake_at(self.now_ns)

    def _wake_at(self, time_ns: int) -> None:
        """Request a tick on the grid at ``time_ns`` or after it, but not at the current time."""
        ticks = max(-(-(time_ns - self._start_ns) // TICK_NS), self._ticks_so_far() + 1)
        due_ns = self._start_ns + ticks * TICK_NS
        if due_ns not in self._due:
            self._due.add(due_ns)
            self.call_later(due_ns - self.now_ns, self._tick_if_due)

    def _ticks_so_far(self) -> int:
        return (self.now_ns - self._start_ns) // TICK_NS

    def _tick_if_due(self) -> None:
        if self.now_ns in self._due:
            self._due.remove(self.now_ns)
            self._tick()

    def _tick(self) -> None:
        if self._goals.current.status is GoalStatus.CANCELING:
            self._end(GoalHandle.canceled, "Goal canceled")
            return
        if self._goals.is_preempted:
            self._goals.accept_pending()
            self._take_goal()
        status = self._tree.execute()
        self._publish_feedback()
        changed = bool(self._changes)
        if changed:
            self._node.log.publish(_BehaviorTreeLog(time_message(self.now_ns), self._changes))
            self._changes = []
        if status is behavior_tree.NodeStatus.SUCCESS:
            self._end(GoalHandle.succeed, "Goal succeeded")
        elif status is behavior_tree.NodeStatus.FAILURE:
            self._end(GoalHandle.abort, "Goal failed")
        elif changed or self._goals.feedback_is_received:
            self._wake()

    # -- feedback --------------------------------------------------------------------------

    def _on_odometry(self, odometry: Any) -> None:
        self._speed = abs(odometry.twist.twist.linear.x)

    def _publish_feedback(self) -> None:
        try:
            pose = self._transforms.lookup(GLOBAL_FRAME, BASE_FRAME)
        except TransformError:
            return
        distance = 0.0 if self._path is None else length_ahead(self._path, pose.x, pose.y)
        moving = self._speed > 0.01 and distance > 0.1
        remaining_ns = int(distance / self._speed * SECOND) if moving else 0
        self._goals.current.publish_feedback(
            _Feedback(
                pose_stamped(self.now_ns, GLOBAL_FRAME, pose.x, pose.y, pose.yaw),
                duration_message(self.now_ns - self._goal_ns),
                duration_message(remaining_ns),
                self.number_of_recoveries,
                distance,
            )
        )
