"""Conditions of the arm that a scenario may change."""

from collections.abc import Mapping

import numpy as np

from sim.arm.cell import JOINTS
from sim.arrays import Floats
from sim.conditions import Range

PLANNED_SPEED = "limits.speed"
BIASES = tuple(f"{what}.bias_{axis}" for what in ("force", "torque") for axis in "xyz")
SHORT = tuple(joint.removesuffix("_joint") for joint in JOINTS)

CONDITIONS: Mapping[str, Range] = {
    **{f"encoder.{joint}": Range(0.0, -0.5, 0.5) for joint in SHORT},  # measured too much [rad]
    **{f"friction.{joint}": Range(0.0, -20.0, 100.0) for joint in SHORT},  # more than usual [N m]
    "payload.mass_kg": Range(0.0, 0.0, 10.0),  # at the gripper, unknown to the controller
    "object.mass_kg": Range(0.0, -0.2, 5.0),  # more than drawn
    "gripper.friction": Range(1.0, 0.0, 2.0),  # of the fingers, relative to the drawn
    "gripper.force": Range(1.0, 0.0, 2.0),
    "servo.gains": Range(1.0, 0.05, 2.0),  # relative to the drawn
    **{name: Range(0.0, -200.0, 200.0) for name in BIASES},  # [N, N m]
    PLANNED_SPEED: Range(1.0, 0.1, 5.0),  # that plans keep, relative to the configured
}
"""Conditions by name; axes are those of tool0."""


def of_joints(conditions: Mapping[str, float], prefix: str) -> Floats:
    """Return a condition of each joint, such as those of ``encoder.``."""
    return np.array([conditions[f"{prefix}{joint}"] for joint in SHORT])
