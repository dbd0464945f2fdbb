"""Feedback for a search: how far physics, messages and beliefs disagree in one run [1]_.

These numbers only guide the search, so they may use ground truth; no verdict sees them.

References
----------
.. [1] S. Kim, T. Kim, "RoboFuzz: fuzzing robotic systems over Robot Operating System (ROS) for
   finding correctness bugs", ESEC/FSE 2022.
"""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
import pandas as pd

from oracle_pipeline.bags.manifest import Manifest

Feedback: TypeAlias = Callable[[pd.DataFrame, Manifest], float]


def sensor_inconsistency(trace: pd.DataFrame, _: Manifest) -> float:
    """Return the mean difference between the yaw rates of odometry and gyroscope [rad/s]."""
    return _mean_difference(trace, "turn", "gyro_turn")


def control_error(trace: pd.DataFrame, _: Manifest) -> float:
    """Return the mean difference between commanded and achieved velocity [m/s]."""
    return _mean_difference(trace, "command_speed", "speed")


def belief_error(trace: pd.DataFrame, manifest: Manifest) -> float:
    """Return how much the path by odometry differs from the path that was driven [m]."""
    believed_m = np.nan_to_num(trace["travelled"].to_numpy(dtype=np.float64)).max(initial=0.0)
    return float(abs(believed_m - sum(goal.driven_m for goal in manifest.goal_results)))


def _mean_difference(trace: pd.DataFrame, one: str, other: str) -> float:
    """Return the mean absolute difference of two signals; 0 where they are never both known."""
    difference = (trace[one] - trace[other]).abs()
    return float(difference.mean()) if difference.notna().any() else 0.0


FEEDBACKS: Mapping[str, Feedback] = {
    "sensors": sensor_inconsistency, "control": control_error, "belief": belief_error,
}  # fmt: skip
