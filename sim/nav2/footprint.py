"""The robot's outline in Nav2: a padded 16-gon around ``base_link``."""

import math
from typing import Any

import numpy as np

from oracle_pipeline.bags.types import message_class
from sim.arrays import Floats
from sim.middleware.stamps import header

_Point32 = message_class("geometry_msgs/msg/Point32")
_Polygon = message_class("geometry_msgs/msg/Polygon")
_PolygonStamped = message_class("geometry_msgs/msg/PolygonStamped")

ROBOT_RADIUS = 0.22  # [m]
PADDING = 0.01  # each vertex moves out by this much along each axis it is off [m]
_VERTICES = 16


def _padded_circle(radius: float, padding: float) -> Floats:
    """Return a circle as a 16-gon, counter-clockwise, shape (16, 2) [m]."""
    angles = np.arange(_VERTICES) * (2.0 * math.pi / _VERTICES)
    # Rounded, so that sin(pi) is zero and has no side to be padded to.
    circle = np.round(radius * np.column_stack([np.cos(angles), np.sin(angles)]), 12)
    padded: Floats = circle + padding * np.sign(circle)
    return padded


def inscribed_radius(polygon: Floats) -> float:
    """Return the distance from the origin to the nearest edge of a polygon around it [m]."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    cross = polygon[:, 0] * edges[:, 1] - polygon[:, 1] * edges[:, 0]
    return float(np.min(np.abs(cross) / lengths))


POLYGON = "geometry_msgs/msg/PolygonStamped"

FOOTPRINT = _padded_circle(ROBOT_RADIUS, PADDING)
FOOTPRINT.setflags(write=False)
INSCRIBED_RADIUS = inscribed_radius(FOOTPRINT)  # 0.2264 m


def polygon_message(time_ns: int, frame: str, polygon: Floats) -> Any:
    """Return ``geometry_msgs/msg/PolygonStamped`` of vertices of shape (n, 2) [m]."""
    points = [_Point32(x, y, 0.0) for x, y in polygon.tolist()]
    return _PolygonStamped(header(time_ns, frame), _Polygon(points))
