"""Positions of the robot's parts: static transforms, mounts of the wheels, and the URDF of both.

Parents, offsets [m] and roll, pitch, yaw [rad] are those of Nav2's Humble Waffle; the two sensors
that the thesis added are the last rows.
"""

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Mount:
    """A frame fixed to its parent."""

    parent: str
    child: str
    xyz: tuple[float, float, float]  # [m]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [rad]

    def quaternion(self) -> tuple[float, float, float, float]:
        """Return the rotation as x, y, z, w."""
        (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a / 2), math.cos(a / 2)) for a in self.rpy)
        return (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )


_OPTICAL = (-1.57, 0.0, -1.57)

BASE_SCAN = Mount("base_link", "base_scan", (-0.064, 0.0, 0.122))
BASE_SCAN_TOM = Mount("base_link", "base_scan_tom", (0.116, 0.0, 0.122))
RANGE_ELLA = Mount("base_link", "range_ella", (0.069, 0.0, 0.068))

STATIC: tuple[Mount, ...] = (
    Mount("base_footprint", "base_link", (0.0, 0.0, 0.010)),
    BASE_SCAN,
    Mount("base_link", "imu_link", (0.0, 0.0, 0.068)),
    Mount("base_link", "caster_back_right_link", (-0.177, -0.064, -0.004), (-1.57, 0.0, 0.0)),
    Mount("base_link", "caster_back_left_link", (-0.177, 0.064, -0.004), (-1.57, 0.0, 0.0)),
    Mount("base_link", "camera_link", (0.064, -0.065, 0.094)),
    Mount("camera_link", "camera_rgb_frame", (0.005, 0.018, 0.013)),
    Mount("camera_rgb_frame", "camera_rgb_optical_frame", (0.0, 0.0, 0.0), _OPTICAL),
    Mount("camera_link", "camera_depth_frame", (0.005, 0.028, 0.013), _OPTICAL),
    Mount("camera_depth_frame", "camera_depth_optical_frame", (0.0, 0.0, 0.0)),
    BASE_SCAN_TOM,
    RANGE_ELLA,
)

WHEELS: tuple[Mount, ...] = (
    Mount("base_link", "wheel_left_link", (0.0, 0.144, 0.023), (-1.57, 0.0, 0.0)),
    Mount("base_link", "wheel_right_link", (0.0, -0.144, 0.023), (-1.57, 0.0, 0.0)),
)
WHEEL_JOINTS = ("wheel_left_joint", "wheel_right_joint")


def robot_description() -> str:
    """Return the robot as URDF: its links and joints, without meshes."""
    robot = ET.Element("robot", name="turtlebot3_waffle")
    ET.SubElement(robot, "link", name="base_footprint")
    for mount in (*STATIC, *WHEELS):
        ET.SubElement(robot, "link", name=mount.child)
    for mount in STATIC:
        _joint(robot, mount.child.removesuffix("_link") + "_joint", "fixed", mount)
    for name, mount in zip(WHEEL_JOINTS, WHEELS, strict=True):
        joint = _joint(robot, name, "continuous", mount)
        ET.SubElement(joint, "axis", xyz="0 0 1")
    return ET.tostring(robot, encoding="unicode", xml_declaration=True)


def _joint(robot: ET.Element, name: str, kind: str, mount: Mount) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=mount.parent)
    ET.SubElement(joint, "child", link=mount.child)
    ET.SubElement(
        joint, "origin", xyz=" ".join(map(str, mount.xyz)), rpy=" ".join(map(str, mount.rpy))
    )
    return joint
