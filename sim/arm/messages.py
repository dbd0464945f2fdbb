"""Messages of many fields, of which the nodes of the arm set a few."""

from typing import Any

import numpy as np

from sim.arm.cell import JOINTS
from sim.arrays import Floats
from sim.fuzzing.value_types import message_type, zero
from sim.middleware.geometry import yaw_quaternion
from sim.middleware.stamps import header

BASE = "base_link"
COLLISION_OBJECT, SCENE = "moveit_msgs/msg/CollisionObject", "moveit_msgs/msg/PlanningScene"
JOINT_STATE, WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
POSE, TRAJECTORY = "geometry_msgs/msg/PoseStamped", "trajectory_msgs/msg/JointTrajectory"
FOLLOW_TYPE = "control_msgs/action/FollowJointTrajectory"
GRIP_TYPE, MOVE_TYPE = "control_msgs/action/GripperCommand", "moveit_msgs/action/MoveGroup"
_BOX = 1  # shape_msgs/msg/SolidPrimitive.BOX


def make(msgtype: str, **fields: Any) -> Any:
    """Return a message with some fields; all other numbers are 0, all other sequences empty."""
    message = zero(message_type(msgtype))
    for name, value in fields.items():
        setattr(message, name, value)
    return message


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> Any:
    """Return ``geometry_msgs/msg/Pose``."""
    at = make("geometry_msgs/msg/Point", x=x, y=y, z=z)
    turn = dict(zip("xyzw", yaw_quaternion(yaw), strict=True))
    turned = make("geometry_msgs/msg/Quaternion", **turn)
    return make("geometry_msgs/msg/Pose", position=at, orientation=turned)


def box(name: str, where: Any, half: tuple[float, ...], now_ns: int) -> Any:
    """Return ``moveit_msgs/msg/CollisionObject`` of a box, from half of its edges [m]."""
    shape = make("shape_msgs/msg/SolidPrimitive", type=_BOX, dimensions=2.0 * np.array(half))
    return make(
        COLLISION_OBJECT, header=header(now_ns, BASE), id=name, pose=where, primitives=[shape],
        primitive_poses=[pose(0.0, 0.0, 0.0)],
    )  # fmt: skip


def joints_of(message: Any) -> Floats | None:
    """Return the positions in a joint state of the arm; None if some are missing or not finite."""
    complete = len(message.position) == len(JOINTS) + 1 and np.isfinite(message.position).all()
    return np.array(message.position) if complete else None


def joint_constraints(joints: Floats) -> Any:
    """Return ``moveit_msgs/msg/Constraints`` for positions of joints [rad]."""
    common = {"tolerance_above": 1e-3, "tolerance_below": 1e-3, "weight": 1.0}
    kind = "moveit_msgs/msg/JointConstraint"
    each = zip(JOINTS, joints.tolist(), strict=True)
    wanted = [make(kind, joint_name=name, position=joint, **common) for name, joint in each]
    return make("moveit_msgs/msg/Constraints", joint_constraints=wanted)
