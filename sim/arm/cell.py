"""The cell: its figures, places of the UR5e's links for given joints, and joints for a place.

Figures are those of MuJoCo's model, ``cell.xml``. The base stands at the origin, x points forward
and z up. All joints turn about the z axis of their link.
"""

import itertools
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from sim.arrays import Floats

CELL = Path(__file__).with_name("cell.xml")
_CELL = ElementTree.parse(CELL)  # noqa: S314 (it is ours)
_BODIES = [body for body in _CELL.iter("body") if body.find("geom[@fromto]") is not None]
LINKS = tuple(body.attrib["name"] for body in _BODIES)


def _each(part: str, key: str) -> list[str]:
    return [found.attrib[key] for body in _BODIES for found in body.findall(part)[:1]]


def _numbers(part: str, key: str) -> Floats:
    return np.array([text.split() for text in _each(part, key)], float)


JOINTS = tuple(_each("joint", "name"))
_ORIGINS, _TURNS = _numbers(".", "pos"), _numbers(".", "euler")  # in the link before [m, rad]
_ENDS = _numbers("geom", "fromto").reshape(-1, 2, 3)  # of a capsule that covers the link [m]
_RADII = _numbers("geom", "size")  # of it [m]

MAX_SPEED = math.pi  # of every joint [rad/s]
FINGER, FINGER_M = "finger_joint", 0.04  # of either finger: its way from closed to open [m]
OBJECT_M, POST_M = (0.02, 0.02, 0.04), (0.03, 0.03, 0.15)  # half of their edges
GRASP_Z = 0.05  # at which the fingers hold the object [m]
TABLE_M, TABLE_X_M = (0.4, 0.6, 0.02), 0.55  # half of its edges; of its middle; its top has z 0
GRIP_M = 0.15  # from tool0 to the point between the fingertips
HOME = (0.0, -1.9, 2.0, -1.67, -math.pi / 2.0, 0.0)  # the gripper points down

_STEPS, _DAMPING, _NEAR = 60, 1e-4, 1e-6  # of the inverse kinematics
_LONGEST = 0.3  # step of it [rad]


_TURNS[0, 2] = math.pi  # of base_link_inertia
_FIXED = Rotation.from_euler("zyx", _TURNS[:, ::-1])
# Spheres in links: along their capsules, so many that they overlap, and around gripper, fingers and
# what they hold.
_GRIPPER = [[0.0, 0.0, z] for z in (0.08, 0.13, 0.17)]
_CENTRES = np.vstack([*np.linspace(_ENDS[:, 0], _ENDS[:, 1], 9, axis=1), _GRIPPER])
_OF = np.repeat(range(len(LINKS)), [9, 9, 9, 9, 9, 9 + len(_GRIPPER)])
RADII = np.append(np.repeat(_RADII, 9), [0.05] * len(_GRIPPER))
"""Radii of the spheres of `spheres` [m]."""


def local(joints: Floats) -> tuple[Floats, Rotation]:
    """Return places [m] and rotations of the links, each in the one before it."""
    return _ORIGINS, _FIXED * Rotation.from_euler("z", joints[:, None])


def frames(joints: Floats) -> Floats:
    """Return each link in the base, shape (6, 4, 4); the last is tool0."""
    placed = np.tile(np.eye(4), (len(LINKS), 1, 1))
    placed[:, :3, 3], turns = local(joints)
    placed[:, :3, :3] = turns.as_matrix()
    for before, here in itertools.pairwise(placed):
        here[:] = before @ here
    return placed


def spheres(joints: Floats) -> Floats:
    """Return the centres of spheres that cover arm and load, in the base, shape (n, 3) [m]."""
    placed = frames(joints)[_OF]
    return np.asarray(np.einsum("nij,nj->ni", placed[:, :3, :3], _CENTRES) + placed[:, :3, 3])


def downward(x: float, y: float, z: float, yaw: float) -> Floats:
    """Return tool0 for a gripper that points down: place of its fingertips [m], yaw [rad]."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("ZX", [yaw, math.pi]).as_matrix()
    matrix[:3, 3] = x, y, z + GRIP_M
    return matrix


def over(x: float, y: float) -> Floats:
    """Return joints with the elbow up and the gripper roughly over a place on the table."""
    aside = math.asin(min(_ORIGINS[3, 2] / max(math.hypot(x, y), 1e-9), 1.0))
    return np.array([math.atan2(y, x) - aside, *HOME[1:]])


def solve(target: Floats, seed: Floats) -> Floats | None:
    """Return joints for a place of tool0, near others; None if they are not found.

    Newton's method with damped least squares.

    Parameters
    ----------
    target
        Place of tool0 in the base, shape (4, 4).
    seed
        The joints at which the search begins [rad].
    """
    joints = np.array(seed)
    for _ in range(_STEPS * int(np.isfinite(target).all())):
        placed = frames(joints)
        here = placed[-1]
        turn = Rotation.from_matrix(target[:3, :3] @ here[:3, :3].T).as_rotvec()
        error = np.concatenate([target[:3, 3] - here[:3, 3], turn])
        if error @ error < _NEAR**2:
            return joints
        axes = placed[:, :3, 2]
        jacobian = np.vstack([np.cross(axes, here[:3, 3] - placed[:, :3, 3]).T, axes.T])
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING * np.eye(6), error)
        joints += step * min(1.0, _LONGEST / max(np.abs(step).max(), 1e-12))
    return None
