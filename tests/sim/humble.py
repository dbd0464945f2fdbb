"""The ROS graph of Humble's ``tb3_simulation_launch.py`` with collision monitor, RViz, client and
recorder, as listed by ``ros2 node info`` and ``ros2 topic info -v`` of the real one.

Implicit endpoints are codes: P publishes and E receives ``/parameter_events``, C receives
``/clock``, L is a lifecycle node that publishes ``<node>/transition_event``, B publishes and
receives ``/bond``. Every node publishes ``/rosout``.

A topic is followed by its QoS where it is known: K keep-last and reliable, TL transient-local and
reliable, BE best effort, each with its depth if known; SYS is ``SystemDefaultsQoS``, of which
Fast DDS shows a reliable publisher and a best-effort subscriber.
"""

import re

LISTENER = "/transform_listener_impl_ADDRESS"
RECORDER = "/rosbag2_recorder"  # subscribes to every visible topic that has a publisher
CAMERA = "/intel_realsense_r200_depth"
LOCAL, GLOBAL = "/local_costmap", "/global_costmap"

_PLAN_TOPICS = (
    "/cmd_vel_nav K1, /cost_cloud K1, /evaluation K1, /local_plan K1, /marker K1, "
    "/received_global_plan K1, /transformed_global_plan K1"
)
_DISPLAYS = (
    "/scan BE, /map TL, /map_updates K, /particle_cloud BE, /plan K, /local_plan K, /waypoints K, "
    "/global_costmap/costmap TL, /global_costmap/costmap_updates K, "
    "/global_costmap/voxel_marked_cloud K, /local_costmap/costmap TL, "
    "/local_costmap/costmap_updates K, /local_costmap/voxel_marked_cloud K, "
    "/local_costmap/published_footprint K, /downsampled_costmap TL, "
    "/downsampled_costmap_updates K, /mobile_base/sensors/bumper_pointcloud K"
)


def _costmap(label):
    return (
        f"{label}/costmap TL1, {label}/costmap_raw TL1, {label}/costmap_updates TL1, "
        f"{label}/published_footprint SYS"
    )


# node: (codes, publishes, subscribes)
NODES = {
    "/gazebo": ("CPE", "/clock BE1, /performance_metrics", ""),
    "/turtlebot3_imu": ("CPE", "/imu K5", ""),
    "/turtlebot3_laserscan": ("CPE", "/scan K5", ""),
    "/turtlebot3_diff_drive": ("CPE", "/odom K1, /tf K100", "/cmd_vel K1"),
    "/turtlebot3_joint_state": ("CPE", "/joint_states K1000", ""),
    f"{CAMERA}_driver": (
        "CPE",
        f"{CAMERA}/camera_info, {CAMERA}/depth/camera_info K1, {CAMERA}/depth/image_raw, "
        f"{CAMERA}/image_raw, {CAMERA}/points K1",
        "",
    ),
    "/robot_state_publisher": (
        "CPE", "/robot_description TL1, /tf K100, /tf_static TL1", "/joint_states"
    ),
    "/nav2_container": ("E", "", ""),
    "/launch_ros_PID": ("P", "", ""),
    "/map_server": ("LBCPE", "/map TL1", ""),
    "/amcl": (
        "LBCPE",
        "/amcl_pose TL1, /particle_cloud BE5, /tf K100",
        "/initialpose SYS, /map TL1, /scan BE5",
    ),
    "/lifecycle_manager_localization": ("BCPE", "/diagnostics", ""),
    "/controller_server": ("LBCPE", _PLAN_TOPICS, "/odom SYS, /speed_limit K10"),
    "/local_costmap/local_costmap": (
        "LCPE",
        f"{_costmap(LOCAL)}, {LOCAL}/clearing_endpoints TL1, {LOCAL}/voxel_grid TL1",
        f"{LOCAL}/footprint SYS, /scan BE50",
    ),
    "/global_costmap/global_costmap": (
        "LCPE", _costmap(GLOBAL), f"{GLOBAL}/footprint SYS, /map TL1, /scan BE50"
    ),
    "/planner_server": ("LBCPE", "/plan K1", ""),
    "/smoother_server": (
        "LBCPE", "/plan_smoothed K1", f"{GLOBAL}/costmap_raw TL1, {GLOBAL}/published_footprint SYS"
    ),
    "/behavior_server": (
        "LBCPE",
        "/cmd_vel K1",
        f"/cmd_vel_teleop SYS, /preempt_teleop SYS, {LOCAL}/costmap_raw, "
        f"{LOCAL}/published_footprint",
    ),
    "/bt_navigator": ("LBCPE", "", "/goal_pose SYS, /odom SYS, /tf, /tf_static"),
    "/bt_navigator_navigate_to_pose_rclcpp_node": ("CPE", "/behavior_tree_log K10", ""),
    "/bt_navigator_navigate_through_poses_rclcpp_node": ("CPE", "/behavior_tree_log K10", ""),
    "/waypoint_follower": ("LBCPE", "", ""),
    "/velocity_smoother": ("LBCPE", "/cmd_vel_raw K1", "/cmd_vel_nav K1"),
    "/lifecycle_manager_navigation": ("BCPE", "/diagnostics", ""),
    "/collision_monitor": ("LBCPE", "/cmd_vel K1, /polygon_stop SYS", "/cmd_vel_raw K1, /scan BE5"),
    "/lifecycle_manager": ("BCPE", "/diagnostics", ""),
    LISTENER: ("E", "", "/tf, /tf_static"),
    "/rviz": ("PE", "/clicked_point, /initialpose", _DISPLAYS),
    "/rviz_navigation_dialog_action_client": ("PE", "/waypoints", ""),
    "/basic_navigator": ("P", "/initialpose", "/amcl_pose"),
    RECORDER: ("E", "/events/write_split", ""),
}  # fmt: skip

LISTENERS = 7

IMPLICIT = {
    "P": ("/parameter_events", ""),
    "E": ("", "/parameter_events"),
    "C": ("", "/clock"),
    "B": ("/bond K5", "/bond K100"),
}

# Where a node has several endpoints on one topic: how many.
SEVERAL = {
    ("/behavior_server", "publishes", "/cmd_vel"): 5,  # each behaviour its own
    **{
        (f"/lifecycle_manager_{which}", end, "/bond"): managed
        for which, managed in (("localization", 2), ("navigation", 7))
        for end in ("publishes", "subscribes")
    },
}

_TRANSITION_EVENT = " ".join(
    f"{node}/transition_event" for node, (codes, *_) in NODES.items() if "L" in codes
)
_TOPICS_OF_TYPE = {
    "bond/msg/Status": "/bond",
    "diagnostic_msgs/msg/DiagnosticArray": "/diagnostics",
    "dwb_msgs/msg/LocalPlanEvaluation": "/evaluation",
    "gazebo_msgs/msg/PerformanceMetrics": "/performance_metrics",
    "geometry_msgs/msg/PointStamped": "/clicked_point",
    "geometry_msgs/msg/Polygon": f"{GLOBAL}/footprint {LOCAL}/footprint",
    "geometry_msgs/msg/PolygonStamped": f"{GLOBAL}/published_footprint "
    f"{LOCAL}/published_footprint /polygon_stop",
    "geometry_msgs/msg/PoseStamped": "/goal_pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "/amcl_pose /initialpose",
    "geometry_msgs/msg/Twist": "/cmd_vel /cmd_vel_nav /cmd_vel_raw /cmd_vel_teleop",
    "lifecycle_msgs/msg/TransitionEvent": _TRANSITION_EVENT,
    "map_msgs/msg/OccupancyGridUpdate": f"{GLOBAL}/costmap_updates {LOCAL}/costmap_updates "
    "/downsampled_costmap_updates /map_updates",
    "nav2_msgs/msg/BehaviorTreeLog": "/behavior_tree_log",
    "nav2_msgs/msg/Costmap": f"{GLOBAL}/costmap_raw {LOCAL}/costmap_raw",
    "nav2_msgs/msg/ParticleCloud": "/particle_cloud",
    "nav2_msgs/msg/SpeedLimit": "/speed_limit",
    "nav2_msgs/msg/VoxelGrid": f"{LOCAL}/voxel_grid",
    "nav_msgs/msg/OccupancyGrid": f"{GLOBAL}/costmap {LOCAL}/costmap /downsampled_costmap /map",
    "nav_msgs/msg/Odometry": "/odom",
    "nav_msgs/msg/Path": "/local_plan /plan /plan_smoothed /received_global_plan "
    "/transformed_global_plan",
    "rcl_interfaces/msg/Log": "/rosout",
    "rcl_interfaces/msg/ParameterEvent": "/parameter_events",
    "rosbag2_interfaces/msg/WriteSplitEvent": "/events/write_split",
    "rosgraph_msgs/msg/Clock": "/clock",
    "sensor_msgs/msg/CameraInfo": f"{CAMERA}/camera_info {CAMERA}/depth/camera_info",
    "sensor_msgs/msg/Image": f"{CAMERA}/depth/image_raw {CAMERA}/image_raw",
    "sensor_msgs/msg/Imu": "/imu",
    "sensor_msgs/msg/JointState": "/joint_states",
    "sensor_msgs/msg/LaserScan": "/scan",
    "sensor_msgs/msg/PointCloud2": f"/cost_cloud {GLOBAL}/voxel_marked_cloud {CAMERA}/points "
    f"{LOCAL}/clearing_endpoints {LOCAL}/voxel_marked_cloud /mobile_base/sensors/bumper_pointcloud",
    "std_msgs/msg/Empty": "/preempt_teleop",
    "std_msgs/msg/String": "/robot_description",
    "tf2_msgs/msg/TFMessage": "/tf /tf_static",
    "visualization_msgs/msg/MarkerArray": "/marker /waypoints",
}
TYPES = {topic: kind for kind, topics in _TOPICS_OF_TYPE.items() for topic in topics.split()}

NEVER_PUBLISHED = set(
    "/cmd_vel_teleop /preempt_teleop /goal_pose /speed_limit /map_updates /downsampled_costmap "
    "/downsampled_costmap_updates /mobile_base/sensors/bumper_pointcloud "
    f"{GLOBAL}/voxel_marked_cloud {LOCAL}/voxel_marked_cloud {GLOBAL}/footprint "
    f"{LOCAL}/footprint".split()
)

# Advertised, and silent in a run: no clicks, smoothing or splits, costmaps are sent completely, and
# parameters change at start-up only.
SILENT_TOPICS = set(
    f"/plan_smoothed /cost_cloud {GLOBAL}/costmap_updates {LOCAL}/costmap_updates /clicked_point "
    "/waypoints /parameter_events /events/write_split".split()
)

# Vertices and edges, and the same with the hidden topics of the actions.
COUNTS = (109, 330)
COUNTS_WITH_HIDDEN = (133, 408)

PARAMETER_SERVICES = {
    "describe_parameters": "rcl_interfaces/srv/DescribeParameters",
    "get_parameter_types": "rcl_interfaces/srv/GetParameterTypes",
    "get_parameters": "rcl_interfaces/srv/GetParameters",
    "list_parameters": "rcl_interfaces/srv/ListParameters",
    "set_parameters": "rcl_interfaces/srv/SetParameters",
    "set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
}
LIFECYCLE_SERVICES = {
    "change_state": "lifecycle_msgs/srv/ChangeState",
    "get_state": "lifecycle_msgs/srv/GetState",
    "get_available_states": "lifecycle_msgs/srv/GetAvailableStates",
    "get_available_transitions": "lifecycle_msgs/srv/GetAvailableTransitions",
    "get_transition_graph": "lifecycle_msgs/srv/GetAvailableTransitions",
}


def _costmap_services(label):
    return {
        f"/{label}/clear_except_{label}": "nav2_msgs/srv/ClearCostmapExceptRegion",
        f"/{label}/clear_around_{label}": "nav2_msgs/srv/ClearCostmapAroundRobot",
        f"/{label}/clear_entirely_{label}": "nav2_msgs/srv/ClearEntireCostmap",
        f"/{label}/get_costmap": "nav2_msgs/srv/GetCostmap",
    }


MANAGED = {
    "/lifecycle_manager_localization": ("/map_server", "/amcl"),
    "/lifecycle_manager_navigation": (
        "/controller_server", "/smoother_server", "/planner_server", "/behavior_server",
        "/bt_navigator", "/waypoint_follower", "/velocity_smoother",
    ),
    "/lifecycle_manager": ("/collision_monitor",),
}  # fmt: skip

SERVICES = {
    "/map_server": {
        "/map_server/map": "nav_msgs/srv/GetMap",
        "/map_server/load_map": "nav2_msgs/srv/LoadMap",
    },
    "/amcl": {
        "/reinitialize_global_localization": "std_srvs/srv/Empty",
        "/request_nomotion_update": "std_srvs/srv/Empty",
        "/set_initial_pose": "nav2_msgs/srv/SetInitialPose",
    },
    "/local_costmap/local_costmap": _costmap_services("local_costmap"),
    "/global_costmap/global_costmap": _costmap_services("global_costmap"),
    "/planner_server": {"/is_path_valid": "nav2_msgs/srv/IsPathValid"},
    **{
        manager: {
            f"{manager}/manage_nodes": "nav2_msgs/srv/ManageLifecycleNodes",
            f"{manager}/is_active": "std_srvs/srv/Trigger",
        }
        for manager in MANAGED
    },
}

_CLEAR = {
    f"/{label}/clear_entirely_{label}": "nav2_msgs/srv/ClearEntireCostmap"
    for label in ("local_costmap", "global_costmap")
}
SERVICE_CLIENTS = {
    "/bt_navigator_navigate_to_pose_rclcpp_node": _CLEAR,
    "/bt_navigator_navigate_through_poses_rclcpp_node": _CLEAR,
    "/basic_navigator": {
        "/map_server/load_map": "nav2_msgs/srv/LoadMap",
        "/global_costmap/get_costmap": "nav2_msgs/srv/GetCostmap",
        "/local_costmap/get_costmap": "nav2_msgs/srv/GetCostmap",
        **_CLEAR,
    },
    **{
        manager: {
            f"{node}/{service}": LIFECYCLE_SERVICES[service]
            for node in managed
            for service in ("change_state", "get_state")
        }
        for manager, managed in MANAGED.items()
    },
}

_TREES = (
    "/bt_navigator_navigate_to_pose_rclcpp_node",
    "/bt_navigator_navigate_through_poses_rclcpp_node",
)
_CLIENT, _DIALOG = "/basic_navigator", "/rviz_navigation_dialog_action_client"

# action: (type, server, clients)
ACTIONS = {
    "/navigate_to_pose": (
        "NavigateToPose",
        "/bt_navigator",
        {"/bt_navigator", "/waypoint_follower", _DIALOG, _CLIENT},
    ),
    "/navigate_through_poses": ("NavigateThroughPoses", "/bt_navigator", {_DIALOG, _CLIENT}),
    "/compute_path_to_pose": ("ComputePathToPose", "/planner_server", {_TREES[0], _CLIENT}),
    "/compute_path_through_poses": (
        "ComputePathThroughPoses", "/planner_server", {_TREES[1], _CLIENT}
    ),
    "/follow_path": ("FollowPath", "/controller_server", {*_TREES, _CLIENT}),
    "/smooth_path": ("SmoothPath", "/smoother_server", {_CLIENT}),
    "/spin": ("Spin", "/behavior_server", {*_TREES, _CLIENT}),
    "/backup": ("BackUp", "/behavior_server", {*_TREES, _CLIENT}),
    "/wait": ("Wait", "/behavior_server", {*_TREES}),
    "/drive_on_heading": ("DriveOnHeading", "/behavior_server", set()),
    "/assisted_teleop": ("AssistedTeleop", "/behavior_server", {_CLIENT}),
    "/follow_waypoints": ("FollowWaypoints", "/waypoint_follower", {_DIALOG, _CLIENT}),
}  # fmt: skip

# RViz is no client of these: it only shows how their goals are.
RVIZ_SHOWS = ("/navigate_to_pose", "/navigate_through_poses")


def plain(node):
    """Return a node's name with the parts that differ between processes replaced."""
    node = re.sub(r"(/transform_listener_impl)_[0-9a-f]+", r"\1_ADDRESS", node)
    return re.sub(r"(/launch_ros)_\d+", r"\1_PID", node)


def implicit_endpoints(codes):
    """Return {(end, topic): QoS, "" if unknown} of codes; an end is "publishes" or "subscribes"."""
    found = {}
    for code in codes:
        found |= _listed(IMPLICIT.get(code, ("", "")))
    return found


def endpoints(node):
    """Return {(end, topic): QoS, "" if unknown} of a node in ``NODES``."""
    codes, *columns = NODES[node]
    found = {("publishes", "/rosout"): "TL"} | implicit_endpoints(codes) | _listed(columns)
    if "L" in codes:
        found["publishes", f"{node}/transition_event"] = "K10"
    return found


def _listed(columns):
    return {
        (end, topic): qos
        for end, column in zip(("publishes", "subscribes"), columns, strict=True)
        for topic, _, qos in (entry.partition(" ") for entry in column.split(", ") if entry)
    }
