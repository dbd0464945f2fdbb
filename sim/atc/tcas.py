"""Threats between aircraft, by the rules of TCAS II version 7.1.

The thresholds are those of FAA, "Introduction to TCAS II Version 7.1" (2011), table 2; the tests
those of Munoz, Narkawicz and Chamberlain, "A TCAS-II Resolution Advisory Detection Algorithm"
(AIAA 2013-4622), without the filter of horizontal miss distance.
"""

import math

import numpy as np

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats

CLEAR, TRAFFIC, RESOLUTION = 0, 1, 2  # as in atc_msgs/msg/Advisory

_FT = 0.3048
_NM = 1852.0

# Lowest own altitude of the row; tau, DMOD and ZTHR of a traffic, then of a resolution advisory.
# Below 1000 ft there are no resolution advisories: no distance is below -1.
_TABLE = np.array(
    [
        [-np.inf, 20.0, 0.30 * _NM, 850 * _FT, -1.0, -1.0, -1.0],
        [1_000 * _FT, 25.0, 0.33 * _NM, 850 * _FT, 15.0, 0.20 * _NM, 600 * _FT],
        [2_350 * _FT, 30.0, 0.48 * _NM, 850 * _FT, 20.0, 0.35 * _NM, 600 * _FT],
        [5_000 * _FT, 40.0, 0.75 * _NM, 850 * _FT, 25.0, 0.55 * _NM, 600 * _FT],
        [10_000 * _FT, 45.0, 1.00 * _NM, 850 * _FT, 30.0, 0.80 * _NM, 600 * _FT],
        [20_000 * _FT, 48.0, 1.30 * _NM, 850 * _FT, 35.0, 1.10 * _NM, 700 * _FT],
        [42_000 * _FT, 48.0, 1.30 * _NM, 1_200 * _FT, 35.0, 1.10 * _NM, 800 * _FT],
    ]
)


@jit
def modified_tau(dx: float, dy: float, dvx: float, dvy: float, dmod_m: float) -> float:
    """Return the time until the horizontal distance falls to about ``dmod_m`` [s].

    Parameters
    ----------
    dx, dy, dvx, dvy
        Of one aircraft relative to the other [m, m/s].
    dmod_m
        Radius of the protected circle.

    Returns
    -------
    float
        0 within the circle, ``inf`` if the aircraft do not come closer.
    """
    squared = dx**2 + dy**2
    if squared <= dmod_m**2:
        return 0.0
    closing = dx * dvx + dy * dvy
    return math.inf if closing >= 0.0 else (dmod_m**2 - squared) / closing


@jit
def is_threat(relative: Floats, tau_s: float, dmod_m: float, zthr_m: float) -> bool:
    """Return whether an aircraft is, or will soon be, too near both horizontally and vertically.

    Parameters
    ----------
    relative : ndarray of shape (6,)
        Its position and velocity relative to the own aircraft [m, m/s].
    tau_s, dmod_m, zthr_m
        Thresholds of time, horizontal and vertical distance.
    """
    dx, dy, dz, dvx, dvy, dvz = relative
    if not modified_tau(dx, dy, dvx, dvy, dmod_m) <= tau_s:
        return False
    return bool(abs(dz) <= zthr_m or (dz * dvz < 0.0 and -dz / dvz <= tau_s))


@jit
def advisory(relative: Floats, altitude_m: float) -> tuple[int, float]:
    """Return the level of the advisory to an aircraft at an altitude, and modified tau [s]."""
    row = 0
    while row + 1 < len(_TABLE) and altitude_m >= _TABLE[row + 1, 0]:
        row += 1
    for level, column in ((RESOLUTION, 4), (TRAFFIC, 1)):
        tau_s, dmod_m, zthr_m = _TABLE[row, column : column + 3]
        if is_threat(relative, tau_s, dmod_m, zthr_m):
            dx, dy, _, dvx, dvy, _ = relative
            return level, modified_tau(dx, dy, dvx, dvy, dmod_m)
    return CLEAR, math.inf


@jit
def advisories(states: Floats) -> list[tuple[int, int, int, float]]:
    """Return the pairs of which the first aircraft is to be warned of the second.

    Parameters
    ----------
    states : ndarray of shape (n, 6)
        Positions and velocities [m, m/s]; one without an altitude (NaN) is no threat to anyone.

    Returns
    -------
    list of tuple
        Number of the own aircraft and of the intruder, level, modified tau [s].
    """
    found = []
    for own in range(len(states)):
        for intruder in range(len(states)):
            if own != intruder:
                level, tau_s = advisory(states[intruder] - states[own], states[own, 2])
                if level != CLEAR:
                    found.append((own, intruder, level, tau_s))
    return found
