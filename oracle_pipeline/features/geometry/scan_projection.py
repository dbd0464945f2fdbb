"""Projection of scans: the ends of their rays in another frame."""

import math

import numpy as np

from oracle_pipeline.bags.jit import jit_unchecked
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.geometry.scans import Floats, Points, Scans


def project(scans: Scans, poses: PlanarPose) -> Points:
    """Return the ends of rays in the parent frame, shape (n, m); NaN without a return.

    Pose i is that of the sensor at scan i.
    """
    translation, rotation, mirrored = poses
    return _project(scans.ranges, scans.rays_along(), translation, rotation, mirrored)


@jit_unchecked
def _project(
    ranges: Floats, rays_along: Points, translation: Points, rotation: Points, mirrored: bool
) -> Points:
    """Do as ``PlanarPose.apply`` does with each row of points, without arrays between."""
    projected = np.empty(ranges.shape, np.complex128)
    for i in range(ranges.shape[0]):
        along = rays_along[i if len(rays_along) > 1 else 0]
        cosine, sine = rotation[i].real, rotation[i].imag
        origin_x, origin_y = translation[i].real, translation[i].imag
        for j in range(ranges.shape[1]):
            distance = ranges[i, j] if abs(ranges[i, j]) < math.inf else math.nan
            x, y = distance * along[j].real, distance * along[j].imag
            y = -y if mirrored else y
            projected[i, j] = complex(
                origin_x + (cosine * x - sine * y), origin_y + (cosine * y + sine * x)
            )
    return projected
