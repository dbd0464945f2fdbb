"""Small recordings, message by message, of a robot with map, scans and odometry."""

import math
from dataclasses import replace

import numpy as np

from oracle_pipeline.bags.manifest import GoalResult, Manifest, Measured, Pose, Software
from oracle_pipeline.bags.types import message_class

QUARTER = math.pi / 2
FAKE_OBJECT = {"frame": "odom", "x": 1.0, "y": 0.0, "radius": 0.2}


def make(name, **fields):
    return message_class(name)(**fields)


def header(frame):
    return make(
        "std_msgs/msg/Header",
        stamp=make("builtin_interfaces/msg/Time", sec=0, nanosec=0),
        frame_id=frame,
    )


def pose(x, y, yaw):
    return make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
        orientation=make(
            "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2)
        ),
    )


def tf(parent, child, x, y, yaw):
    at = pose(x, y, yaw)
    transform = make(
        "geometry_msgs/msg/Transform",
        translation=make("geometry_msgs/msg/Vector3", x=x, y=y, z=0.0),
        rotation=at.orientation,
    )
    stamped = make(
        "geometry_msgs/msg/TransformStamped",
        header=header(parent),
        child_frame_id=child,
        transform=transform,
    )
    return make("tf2_msgs/msg/TFMessage", transforms=[stamped])


def odometry(x, y, yaw):
    zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    return make(
        "nav_msgs/msg/Odometry",
        header=header("odom"),
        child_frame_id="base_footprint",
        pose=make(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose(x, y, yaw), covariance=np.zeros(36)
        ),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def scan(frame, *ranges):
    return make(
        "sensor_msgs/msg/LaserScan",
        header=header(frame),
        angle_min=0.0,
        angle_max=0.0,
        angle_increment=QUARTER,
        time_increment=0.0,
        scan_time=0.2,
        range_min=0.1,
        range_max=3.5,
        ranges=np.array(ranges, dtype=np.float32),
        intensities=np.array([], dtype=np.float32),
    )


def grid(frame, cells, resolution, origin):
    cells = np.array(cells, dtype=np.int8)
    info = make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=make("builtin_interfaces/msg/Time", sec=0, nanosec=0),
        resolution=resolution,
        width=cells.shape[1],
        height=cells.shape[0],
        origin=origin,
    )
    return make("nav_msgs/msg/OccupancyGrid", header=header(frame), info=info, data=cells.ravel())


# Messages as (topic, type, message).
MAP_TO_ODOM = ("/tf", "tf2_msgs/msg/TFMessage", tf("map", "odom", 10.0, 0.0, QUARTER))
MOUNT = (
    "/tf_static",
    "tf2_msgs/msg/TFMessage",
    tf("base_footprint", "base_scan_tom", 0.5, 0.0, 0.0),
)
MAP = (
    "/map",
    "nav_msgs/msg/OccupancyGrid",
    grid("map", [[-1, 0, 100], [0, 0, 0]], 0.5, pose(-1.0, -2.0, 0.0)),
)
COSTMAP = (
    "/local_costmap/costmap",
    "nav_msgs/msg/OccupancyGrid",
    grid("odom", [[0, 99], [100, -1]], 1.0, pose(-1.0, -1.0, 0.0)),
)


def at(x, y, yaw=0.0):
    return ("/odom", "nav_msgs/msg/Odometry", odometry(x, y, yaw))


def standing(x, y, frame="odom"):
    """The position of the base, as a transform."""
    return ("/tf", "tf2_msgs/msg/TFMessage", tf(frame, "base_footprint", x, y, 0.0))


def seen(*ranges):
    return ("/scan_fakeobject", "sensor_msgs/msg/LaserScan", scan("base_scan_tom", *ranges))


def scanned(*ranges):
    return ("/scan", "sensor_msgs/msg/LaserScan", scan("base_footprint", *ranges))


def planned(*points):
    poses = [
        make("geometry_msgs/msg/PoseStamped", header=header("map"), pose=pose(x, y, 0.0))
        for x, y in points
    ]
    return (
        "/plan",
        "nav_msgs/msg/Path",
        make("nav_msgs/msg/Path", header=header("map"), poses=poses),
    )


def ticked(node, previous, current):
    """A node of the behaviour tree changed its status."""
    now = make("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    change = make(
        "nav2_msgs/msg/BehaviorTreeStatusChange",
        timestamp=now,
        node_name=node,
        previous_status=previous,
        current_status=current,
    )
    log = make("nav2_msgs/msg/BehaviorTreeLog", timestamp=now, event_log=[change])
    return ("/behavior_tree_log", "nav2_msgs/msg/BehaviorTreeLog", log)


def ended(accepted_s, ended_s, outcome="succeeded"):
    return GoalResult(accepted_s, ended_s, outcome, driven_m=1.0, recoveries=0)


def manifest(label="malicious", attack=FAKE_OBJECT, **changes):
    """Manifest of a run of one goal, of a robot that starts at it."""
    base = Manifest(
        mode="fake_object",
        label=label,
        run=3,
        block=3,
        session=0,
        world="hexagon-0",
        seed=0,
        start=Pose(10.0, 0.0, QUARTER),
        goals=(Pose(10.0, 2.0, 0.0),),
        goal_results=(ended(0.0, 1.0),),
        outcome="succeeded",
        onset_s=None,
        attack=attack,
        scenario="",
        scenario_hash="0" * 64,
        task_effect=None,
        recording_s=1.0,
        contacts=(),
        topics={},
        content_hash="0" * 64,
        recipe={},
        software=Software("", "", ""),
        measured=Measured(0.0, {}),
    )
    return replace(base, **changes)
