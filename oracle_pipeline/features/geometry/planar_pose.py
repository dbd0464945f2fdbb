"""Poses in the plane: how they act on points, combine, and change over time.

Points are complex numbers, x + iy [m], so that a rotation is a product and a translation a sum.
"""

from typing import NamedTuple, Self

import numpy as np

from oracle_pipeline.features.geometry.scans import Floats, Ints, Points


class PlanarPose(NamedTuple):
    """One pose or many: ``p -> translation + rotation * p``, with p mirrored first if ``mirrored``.

    A scanner that hangs upside down is mirrored.
    """

    translation: Points  # [m]
    rotation: Points  # exp(i yaw)
    mirrored: bool = False

    @classmethod
    def of(cls, x: Floats, y: Floats, yaw: Floats) -> Self:
        """Return the poses with some coordinates [m] and yaws [rad]."""
        return cls(x + 1j * y, np.exp(1j * yaw))

    def apply(self, points: Points) -> Points:
        """Return points of the child frame in the parent frame."""
        return self.translation + self.rotate(points)

    def rotate(self, directions: Points) -> Points:
        """Return directions of the child frame in the parent frame."""
        return self.rotation * (directions.conj() if self.mirrored else directions)

    def compose(self, child: "PlanarPose") -> "PlanarPose":
        """Return the pose of ``child``'s child in this one's parent."""
        mirrored = self.mirrored != child.mirrored
        return PlanarPose(self.apply(child.translation), self.rotate(child.rotation), mirrored)

    def inverse(self) -> "PlanarPose":
        """Return the pose of the parent in the child."""
        if self.mirrored:
            translation = -self.rotation * self.translation.conj()
            return PlanarPose(translation, self.rotation, mirrored=True)
        return PlanarPose(-self.rotation.conj() * self.translation, self.rotation.conj())

    def at(self, index: slice | Ints) -> "PlanarPose":
        """Return some of many poses."""
        return PlanarPose(self.translation[index], self.rotation[index], self.mirrored)

    def columns(self) -> "PlanarPose":
        """Return the poses as columns, to apply each to a row of points."""
        translation, rotation = (np.asarray(part)[..., np.newaxis] for part in self[:2])
        return PlanarPose(translation, rotation, self.mirrored)


class PosePath:
    """Poses over time, interpolated between their stamps.

    Parameters
    ----------
    stamps_s : ndarray of shape (n,)
        Ascending [s].
    x, y, yaw : ndarray of shape (n,)
        Coordinates [m] and yaw [rad]; the yaw may jump by full turns.
    """

    def __init__(self, stamps_s: Floats, x: Floats, y: Floats, yaw: Floats) -> None:
        self._stamps_s = stamps_s
        self._columns = x, y, np.unwrap(yaw)

    @classmethod
    def through(cls, stamps_s: Floats, pose: PlanarPose) -> Self:
        """Return the path through some poses that are not mirrored."""
        x, y = pose.translation.real, pose.translation.imag
        return cls(stamps_s, x, y, np.angle(pose.rotation))

    def at(self, stamps_s: Floats) -> PlanarPose:
        """Return the pose at each stamp."""
        return PlanarPose.of(
            *(np.interp(stamps_s, self._stamps_s, column) for column in self._columns)
        )
