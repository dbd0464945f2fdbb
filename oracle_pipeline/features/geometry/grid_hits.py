"""The cells of a grid that points of scans hit, and the one that most scans hit."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine.plugin import Missing
from oracle_pipeline.features.geometry.scans import Bools, Ints, Points

CELL_M = 0.25  # edge of the cells in which contradictions are counted
MOST_HITS = 2**23  # limit for one plugin and recording
_FARTHEST_CELL = 2**30


@dataclass(frozen=True, slots=True)
class Hits:
    """The cells of a grid that scans hit: each pair of scan and cell once."""

    scans: NDArray[np.int32]  # in order
    cells: NDArray[np.int32]  # any numbering

    def persistence(self, scans: slice) -> float:
        """Return the largest share of some scans that hit the same cell; NaN without scans."""
        if scans.start == scans.stop:
            return math.nan
        first, after = np.searchsorted(self.scans, (scans.start, scans.stop))
        counts = np.bincount(self.cells[first:after], minlength=1)
        return float(counts.max() / (scans.stop - scans.start))


class HitCounter:
    """Finds the hits of scans, block by block, up to a limit.

    Parameters
    ----------
    most : int
        Hits that are kept.
    """

    def __init__(self, most: int) -> None:
        self._blocks: list[Ints] = []
        self._left = most

    def add(self, points: Points, chosen: Bools, first: int) -> None:
        """Count chosen points, both of shape (n, m); the first row belongs to scan ``first``."""
        rows = _hits(points, chosen, first)
        self._left -= len(rows)
        if self._left >= 0:
            self._blocks.append(rows)
        else:
            self._blocks.clear()

    def hits(self) -> Hits | Missing:
        """Return the hits; `Missing` if there are too many."""
        if self._left < 0:
            return Missing("too many contradicted returns for the limit MOST_HITS")
        rows = np.concatenate([np.zeros((0, 2), np.int64), *self._blocks])
        _, cells = np.unique(rows[:, 1], return_inverse=True)
        return Hits(rows[:, 0].astype(np.int32), cells.reshape(-1).astype(np.int32))


@jit
def _hits(points: Points, chosen: Bools, first: int) -> Ints:
    """Return the scans and cells of chosen points, each pair once; shape (n, 2)."""
    found = np.empty((chosen.sum(), 2), np.int64)
    cells = np.empty(points.shape[1], np.int64)
    number = 0
    for i in range(points.shape[0]):
        count = 0
        for j in range(points.shape[1]):
            if chosen[i, j]:
                cells[count] = _cell(points[i, j].real) << 32 | _cell(points[i, j].imag)
                count += 1
        own = np.sort(cells[:count])
        for k in range(count):
            if k == 0 or own[k] != own[k - 1]:
                found[number, 0], found[number, 1] = first + i, own[k]
                number += 1
    return found[:number].copy()


@jit
def _cell(coordinate: float) -> int:
    """Return the number of a cell along an axis, from 0 on."""
    cell = min(max(coordinate / CELL_M, -_FARTHEST_CELL), _FARTHEST_CELL)  # fits an integer
    return math.floor(cell) + _FARTHEST_CELL
