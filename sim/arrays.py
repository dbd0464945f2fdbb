"""Names for arrays of numbers, whose shapes docstrings and comments state."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
