"""Speed and turning of the robot, from its odometry.

The thesis uses the variance of yaw wrapped to (-pi, pi], which jumps when the robot faces -x; here
it is the circular variance, with total turning and the yaw rate.
"""

from typing import Any

import numpy as np

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.common_fields import poses_of
from oracle_pipeline.features.geometry.scans import Floats
from oracle_pipeline.robots.roles import ODOMETRY

FEATURES = (
    fp.Feature(
        "yaw_variance", "1", 1e-3, "circular variance of yaw, 1 - abs(mean(exp(i yaw)))", "domain",
        behaviour=True, extensive=True,
    ),
    fp.Feature("total_turning", "rad", 0.05, "sum of the absolute yaw changes", "domain",
        behaviour=True, extensive=True),
    fp.Feature(
        "turning_per_metre", "rad/m", 0.05, "sum of the absolute yaw changes over the path length",
        "domain",
        behaviour=True,
    ),
    fp.Feature(
        "yaw_rate_variance", "rad^2/s^2", 1e-4, "variance of the yaw rate from odometry", "domain",
        behaviour=True,
    ),
    fp.Feature("speed", "m/s", 0.01, "path length divided by time", "domain", behaviour=True),
)  # fmt: skip

_SHORTEST_PATH_M = 0.1  # shorter ones are noise of the odometry


def keep(messages: Any) -> tuple[Floats, Floats, Floats, Floats]:
    """Return x [m], y [m], yaw [rad] and yaw rate [rad/s] of ``nav_msgs/msg/Odometry``."""
    return *poses_of(messages.pose.pose), messages.twist.twist.angular.z


def compute(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute from the robot's odometry."""
    (series,) = window.topics["odometry"].values()
    x, y, yaw, rate = series.values.T
    turning = float(np.abs(np.angle(np.exp(1j * np.diff(yaw)))).sum())
    path_m = float(np.hypot(np.diff(x), np.diff(y)).sum())
    still = fp.Missing(f"the robot moved less than {_SHORTEST_PATH_M} m")
    return {
        "yaw_variance": max(0.0, 1.0 - float(np.abs(np.mean(np.exp(1j * yaw))))),
        "total_turning": turning,
        "turning_per_metre": turning / path_m if path_m >= _SHORTEST_PATH_M else still,
        "yaw_rate_variance": float(rate.var()),
        "speed": path_m / (window.end_s - window.start_s),
    }


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of odometry."""
    topics = {"odometry": fp.Request(keep, role=ODOMETRY, many=True)}
    return [fp.FeaturePlugin("odometry", "contextual", FEATURES, compute, topics)]
