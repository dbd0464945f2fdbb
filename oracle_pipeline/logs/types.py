"""Guess the ROS type of a table from the names of its columns, as rosbag exports have them."""

import functools
from collections.abc import Mapping
from typing import Any

from oracle_pipeline.logs.recording import numeric_paths

# The first that fits counts: a table of `linear` and `angular` is a Twist rather than an Accel.
_CANDIDATES = (
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/MagneticField",
    "sensor_msgs/msg/Range",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/WrenchStamped",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/Wrench",
)


def guessed_type(columns: Mapping[str, Any]) -> str:
    """Return the type whose fields the columns are; empty if there is none.

    All numbers of the type must be there but for covariances and the header, and the table must
    have no other columns. ROS 1's names of the header count.
    """
    names = {name for name in columns if not name.startswith("header.")}
    for msgtype in _CANDIDATES:
        required, known = _fields(msgtype)
        if required <= names <= known:
            return msgtype
    return ""


@functools.cache
def _fields(msgtype: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return the fields that a table of a type must have, and all that it may have."""
    paths = frozenset(p for p in numeric_paths(msgtype) if not p.startswith("header."))
    optional = {p for p in paths if "covariance" in p or p.startswith("status.")}
    return paths - optional, paths
