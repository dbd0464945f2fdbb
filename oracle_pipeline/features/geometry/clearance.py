"""Distance of each cell of a grid from the nearest blocked one.

Like ``scipy.ndimage.distance_transform_edt``, whose import takes longer than most recordings.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit


def clearance(blocked: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the distance from each cell's centre to that of the nearest blocked cell [cells].

    Exact, in two passes over the grid [1]_.

    Parameters
    ----------
    blocked : ndarray of shape (rows, columns)
        At least one cell is blocked.

    References
    ----------
    .. [1] A. Meijster et al., "A general algorithm for computing distance transforms in linear
       time", 2000.

    Examples
    --------
    >>> clearance(np.array([[False, False, True], [False, False, False]])).round(2).tolist()
    [[2.0, 1.0, 0.0], [2.240000009536743, 1.409999966621399, 1.0]]
    """
    squared: NDArray[np.int64] = _squared(blocked)
    return np.sqrt(squared).astype(np.float32)


@jit
def _squared(blocked: NDArray[np.bool_]) -> Any:
    rows, columns = blocked.shape
    far = rows + columns  # more than any distance
    along = np.empty((rows, columns), np.int64)  # to the nearest blocked cell of the column
    for x in range(columns):
        near = far
        for y in range(rows):
            near = 0 if blocked[y, x] else min(near + 1, far)
            along[y, x] = near
        for y in range(rows - 1, -1, -1):
            near = 0 if blocked[y, x] else min(near + 1, far)
            along[y, x] = min(along[y, x], near)
    squared = np.empty((rows, columns), np.int64)
    nearest, begins = np.empty(columns, np.int64), np.empty(columns, np.int64)
    for y in range(rows):
        # Column nearest[k] has the nearest blocked cell for columns from begins[k] on.
        last = 0
        nearest[0] = begins[0] = 0
        for x in range(1, columns):
            while last >= 0:
                begin, old = begins[last], nearest[last]
                if (begin - old) ** 2 + along[y, old] ** 2 <= (begin - x) ** 2 + along[y, x] ** 2:
                    break
                last -= 1
            if last < 0:
                last = 0
                nearest[0], begins[0] = x, 0
                continue
            old = nearest[last]
            gain = x * x - old * old + along[y, x] ** 2 - along[y, old] ** 2
            begin = 1 + gain // (2 * (x - old))
            if begin < columns:
                last += 1
                nearest[last], begins[last] = x, begin
        for x in range(columns - 1, -1, -1):
            squared[y, x] = (x - nearest[last]) ** 2 + along[y, nearest[last]] ** 2
            if x == begins[last]:
                last -= 1
    return squared
