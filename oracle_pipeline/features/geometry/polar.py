"""Points as a scanner sees them: how far away, and nearest to which ray.

Every plugin of scans asks this of every point, so both are fast, and exactly what the functions of
the C library say.
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit, jit_unchecked

_Floats: TypeAlias = NDArray[np.float64]
_Ints: TypeAlias = NDArray[np.int64]

# Of arctan(r) / r in r squared, a Chebyshev fit over 0 to 1.
_C0, _C1, _C2, _C3, _C4, _C5, _C6 = (
    0.9999956247352713, -0.3331600416561674, 0.1979690288757025, -0.1319592553196681,
    0.07900004893299771, -0.033105310818130625, 0.006658278292940012,
)  # fmt: skip
_ERROR_RAD = 1e-6  # more than three times that of the fit
_UNSURE = -(2**62)  # a number that no ray has
_LEVEL = 1e-6  # |y/x| below which the sign of zero may tell the bearing


@jit_unchecked
def distances(x: _Floats, y: _Floats, out: _Floats) -> None:
    """Write the distances of points: ``hypot``, by the algorithm of the C library.

    It does without scaling, so that the squares of the coordinates have to be numbers.

    Source: C. F. Borges, An improved algorithm for hypot(a,b), ACM TOMS 47 (2021).
    """
    for j in range(len(x)):
        large, small = max(abs(x[j]), abs(y[j])), min(abs(x[j]), abs(y[j]))
        length = math.sqrt(large * large + small * small)
        near = length <= 2.0 * small
        rest = length - (small if near else large)
        first = large * (2.0 * rest - large) if near else 2.0 * rest * (large - 2.0 * small)
        second = (rest - 2.0 * (large - small)) * rest
        second = second if near else (4.0 * rest - small) * small + rest * rest
        out[j] = length - (first + second) / (2.0 * length + (length == 0.0))


@jit
def rays(x: _Floats, y: _Floats, start: float, increment: float, out: _Ints) -> None:
    """Write the number of the ray nearest to each point, as if rays continued in circles.

    It is ``round((atan2(y, x) - start) / increment)``. A polynomial tells as much, unless a point
    is about half-way between two rays. What is written for NaN means nothing.
    """
    _nearly(x, y, start, increment, out)
    for j in range(len(x)):
        if out[j] == _UNSURE and not math.isnan(x[j]):
            out[j] = round((math.atan2(y[j], x[j]) - start) / increment)


@jit_unchecked
def _nearly(x: _Floats, y: _Floats, start: float, increment: float, out: _Ints) -> None:
    """Write the nearest rays by the polynomial, `_UNSURE` where they are not beyond doubt."""
    sure = 0.5 - _ERROR_RAD / abs(increment)
    for j in range(len(x)):
        large, small = max(abs(x[j]), abs(y[j])), min(abs(x[j]), abs(y[j]))
        r = small / large
        s = r * r
        bearing = (((((_C6 * s + _C5) * s + _C4) * s + _C3) * s + _C2) * s + _C1) * s + _C0
        bearing *= r
        bearing = math.pi / 2.0 - bearing if abs(y[j]) > abs(x[j]) else bearing
        bearing = math.pi - bearing if x[j] < 0.0 else bearing
        place = ((-bearing if y[j] < 0.0 else bearing) - start) / increment
        ray = math.floor(place + 0.5)
        is_sure = (abs(place - ray) < sure) & (abs(y[j]) > _LEVEL * abs(x[j]))
        out[j] = ray if is_sure else _UNSURE
