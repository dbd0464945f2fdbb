"""Recordings of robots: complete ones, and empty topics with names and types only."""

from pathlib import Path

from oracle_pipeline.bags.types import message_class
from oracle_pipeline.bags.writer import BagWriter
from tests.oracle_pipeline.features.scenery import (
    believed_message,
    grid_message,
    header,
    odometry_message,
    scan_message,
    transforms,
)

SCAN, CLOUD = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"
ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
JOINTS, TF = "sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage"
GRID, POSE = "nav_msgs/msg/OccupancyGrid", "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH, STRING = "nav_msgs/msg/Path", "std_msgs/msg/String"


def bag_with(path: Path, topics: dict[str, str]) -> Path:
    """Write a bag that has topics of some types, and one unused message."""
    with BagWriter(path) as bag:
        for name, msgtype in topics.items():
            bag.add_topic(name, msgtype, [])
        bag.add_topic("/rosout_of_tests", STRING, [])
        bag.write("/rosout_of_tests", 1, b"\x00\x01\x00\x00\x01\x00\x00\x00\x00")
    return path


def odometry(child, frame="odom"):
    message = odometry_message(0.0, 0j, 0.0)
    message.header.frame_id, message.child_frame_id = frame, child
    return message


def grid(frame):
    message = grid_message(0.0, [[0, 100]], 0.05, 0j)
    message.header.frame_id = frame
    return message


def pose(frame):
    message = believed_message(0.0, 0j, 0.0)
    message.header.frame_id = frame
    return message


def scan(frame):
    return scan_message(0.0, frame, [1.0, 2.0, 3.0])


def static(*joints):
    """Parent and child of fixed transforms."""
    return transforms(*((parent, child, 0.1, False) for parent, child in joints))


def stamped_twist(seconds, forward, turn):
    vector = message_class("geometry_msgs/msg/Vector3")
    twist = message_class(TWIST)(vector(forward, 0.0, 0.0), vector(0.0, 0.0, turn))
    return message_class(STAMPED)(header(seconds, "base"), twist)
