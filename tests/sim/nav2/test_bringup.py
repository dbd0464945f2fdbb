"""The whole of Nav2: its graph against the sheet of the real one, and a drive among the pillars."""

import numpy as np
import pytest

from sim.middleware.domain import Domain, is_hidden
from sim.middleware.executor import SECOND, Executor
from sim.middleware.geometry import Pose2D
from sim.nav2.bringup import bring_up
from sim.turtlebot3.map import WORLD_IN_MAP, turtlebot3_world_map
from sim.turtlebot3.nodes import LidarNoise, add_robot
from sim.turtlebot3.world import World, WorldParameters

# Humble's nodes: implicit endpoints (L lifecycle, B bond, C clock, P and E parameter events), then
# topics published and heard, /tf's listeners and the simulator's nodes left out.
NODES = {
    "/nav2_container": ("E", "", ""),
    "/launch_ros_4007": ("P", "", ""),
    "/map_server": ("LBCPE", "/map", ""),
    "/amcl": ("LBCPE", "/amcl_pose /particle_cloud /tf", "/initialpose /map /scan"),
    "/lifecycle_manager_localization": ("BCPE", "/diagnostics", ""),
    "/controller_server": (
        "LBCPE",
        "/cmd_vel_nav /cost_cloud /evaluation /local_plan /marker /received_global_plan "
        "/transformed_global_plan",
        "/odom /speed_limit",
    ),
    "/local_costmap/local_costmap": (
        "LCPE",
        "/local_costmap/clearing_endpoints /local_costmap/costmap /local_costmap/costmap_raw "
        "/local_costmap/costmap_updates /local_costmap/published_footprint "
        "/local_costmap/voxel_grid",
        "/local_costmap/footprint /scan /scan_fakeobject",
    ),
    "/global_costmap/global_costmap": (
        "LCPE",
        "/global_costmap/costmap /global_costmap/costmap_raw /global_costmap/costmap_updates "
        "/global_costmap/published_footprint",
        "/global_costmap/footprint /map /scan /scan_fakeobject",
    ),
    "/planner_server": ("LBCPE", "/plan", ""),
    "/smoother_server": (
        "LBCPE",
        "/plan_smoothed",
        "/global_costmap/costmap_raw /global_costmap/published_footprint",
    ),
    "/behavior_server": (
        "LBCPE",
        "/cmd_vel",
        "/cmd_vel_teleop /preempt_teleop /local_costmap/costmap_raw "
        "/local_costmap/published_footprint",
    ),
    "/bt_navigator": ("LBCPE", "", "/goal_pose /odom /tf /tf_static"),
    "/bt_navigator_navigate_to_pose_rclcpp_node": ("CPE", "/behavior_tree_log", ""),
    "/bt_navigator_navigate_through_poses_rclcpp_node": ("CPE", "/behavior_tree_log", ""),
    "/waypoint_follower": ("LBCPE", "", ""),
    "/velocity_smoother": ("LBCPE", "/cmd_vel_raw", "/cmd_vel_nav"),
    "/lifecycle_manager_navigation": ("BCPE", "/diagnostics", ""),
    "/collision_monitor": (
        "LBCPE",
        "/cmd_vel /polygon_slowdown /polygon_stop",
        "/cmd_vel_raw /range_ella /scan /scan_fakeobject /scan_tom",
    ),
    "/lifecycle_manager": ("BCPE", "/diagnostics", ""),
    "/rviz": (
        "PE",
        "/clicked_point /initialpose",
        "/scan /map /map_updates /particle_cloud /plan /local_plan /waypoints "
        "/global_costmap/costmap /global_costmap/costmap_updates "
        "/global_costmap/voxel_marked_cloud /local_costmap/costmap /local_costmap/costmap_updates "
        "/local_costmap/voxel_marked_cloud /local_costmap/published_footprint "
        "/downsampled_costmap /downsampled_costmap_updates "
        "/mobile_base/sensors/bumper_pointcloud",
    ),
    "/rviz_navigation_dialog_action_client": ("PE", "/waypoints", ""),
    "/basic_navigator": ("P", "/initialpose", "/amcl_pose"),
}
IMPLICIT = {"/bond", "/clock", "/parameter_events", "/rosout"}
START = Pose2D(-2.0, -0.5)  # in the world


class System:
    """World, robot and Nav2, active."""

    def __init__(self, run=7):
        self.world = World(WorldParameters(START))
        self.executor = Executor(on_advance=self.world.advance_to)
        self.domain = Domain(self.executor)

        def generator(node):
            return np.random.default_rng([run, *node.encode()])

        add_robot(self.domain, self.world, LidarNoise(), generator)
        self.simulator = set(self.domain.node_names())
        self.nav2 = bring_up(
            self.domain, turtlebot3_world_map(), generator=generator, latency_ns=2_000_000, run=run
        )
        self.nav2.navigator.set_initial_pose(WORLD_IN_MAP.compose(START))
        self.executor.run_until(10 * SECOND, stop=lambda: self.nav2.is_active)

    def nav2_nodes(self):
        return set(self.domain.node_names()) - self.simulator


@pytest.fixture(scope="module")
def system():
    return System()


def test_nav2_becomes_active_soon_after_the_initial_pose(system):
    assert system.nav2.is_active
    assert system.executor.now_ns < 5 * SECOND


def test_every_node_of_the_sheet_is_there_and_no_other(system):
    nodes = system.nav2_nodes()
    listeners = {node for node in nodes if node.startswith("/transform_listener_impl_")}
    assert len(listeners) == 7
    assert nodes - listeners == set(NODES)


@pytest.mark.parametrize("node", NODES)
def test_a_node_publishes_and_hears_what_it_does_in_life(system, node):
    domain = system.domain
    published, heard = domain.publishers_of(node), domain.subscriptions_of(node)
    events = {topic for topic in published if topic.endswith("/transition_event")}
    codes = {
        "L": bool(events),
        "B": "/bond" in published and "/bond" in heard,
        "C": "/clock" in heard,
        "P": "/parameter_events" in published,
        "E": "/parameter_events" in heard,
    }
    implicit, publishes, hears = NODES[node]
    assert {code for code, has in codes.items() if has} == set(implicit)
    assert "/rosout" in published
    ignored = IMPLICIT | events
    assert {t for t in published if not is_hidden(t)} - ignored == set(publishes.split())
    assert {t for t in heard if not is_hidden(t)} - ignored == set(hears.split())


def test_actions_have_the_servers_of_the_sheet(system):
    servers = {node: set(system.domain.action_servers_of(node)) for node in NODES}
    assert {node: names for node, names in servers.items() if names} == {
        "/behavior_server": {
            "/spin", "/backup", "/drive_on_heading", "/assisted_teleop", "/wait"
        },
        "/bt_navigator": {"/navigate_to_pose", "/navigate_through_poses"},
        "/controller_server": {"/follow_path"},
        "/planner_server": {"/compute_path_to_pose", "/compute_path_through_poses"},
        "/smoother_server": {"/smooth_path"},
        "/waypoint_follower": {"/follow_waypoints"},
    }  # fmt: skip


def test_names_that_stand_for_processes_come_from_the_run_alone(system):
    again, other = System(run=7).nav2_nodes(), System(run=8).nav2_nodes()
    assert again == system.nav2_nodes()
    assert len(again - other) == 8  # seven listeners and the launch process


def test_the_robot_visits_poses_among_the_pillars_without_touching_anything():
    system = System()
    navigator = system.nav2.navigator
    goals = [Pose2D(-0.55, 0.55, 1.0), Pose2D(0.55, -0.55, -2.0)]
    done = []
    navigator.follow(goals, lambda: done.append(system.executor.now_ns))
    system.executor.run_until(90 * SECOND, stop=lambda: bool(done))
    assert [result.outcome for result in navigator.results] == ["succeeded", "succeeded"]
    assert [result.number_of_recoveries for result in navigator.results] == [0, 0]
    assert system.world.touches == []
    here = WORLD_IN_MAP.compose(system.world.pose)
    assert here.distance_to(goals[-1]) < 0.35  # 0.25 m by its own estimate
