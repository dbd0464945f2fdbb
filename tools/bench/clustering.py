"""Clustering at scale: weighted rows compared with SciPy on copies, and many distinct rows.

Rows are synthetic: 40 features, normally distributed around 50 centres.
"""

import resource
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import linkage

from oracle_pipeline.clustering.tree import LINKAGES, Linkage, grow_tree
from tools.bench.figures import Row, median, spread

FEATURES, CENTRES = 40, 50
RUNS, BOOTSTRAPPED, ROUNDS = 90, 10_000, 3
DISTINCT = 100_000
WITHOUT_MATRIX: tuple[Linkage, ...] = ("single", "ward")


def rows() -> Iterator[Row]:
    """Yield the figures."""
    rng = np.random.default_rng(0)
    few = _features(RUNS, rng)
    for method in LINKAGES:
        grow_tree(few, method)  # compiles the hot loops, unless they are cached
    many = _features(DISTINCT, rng)
    for method in WITHOUT_MATRIX:
        seconds = _seconds(grow_tree, many, method)
        yield Row(f"{method}, {DISTINCT:,} distinct rows", seconds, "s", 600)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    yield Row("peak memory so far", peak, "MiB", 2048)

    drawn = np.sort(rng.integers(RUNS, size=BOOTSTRAPPED))
    distinct, copies = np.unique(drawn, return_counts=True)
    for method in LINKAGES:
        ratios = []
        for _ in range(ROUNDS):
            ours = _seconds(grow_tree, few[distinct], method, copies)
            ratios.append(_seconds(linkage, few[drawn], method) / ours)
        name = f"{method}, {BOOTSTRAPPED:,} rows of {RUNS} runs: SciPy over ours"
        yield Row(name, median(ratios), "x", 100, False, spread(ratios))


def _features(n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    centres = rng.normal(scale=3.0, size=(CENTRES, FEATURES))
    return rng.normal(size=(n, FEATURES)) + centres[rng.integers(CENTRES, size=n)]


def _seconds(function: Callable[..., object], *arguments: object) -> float:
    """Return the processor time of a call, which does not depend on how busy the machine is."""
    started = time.process_time()
    function(*arguments)
    return time.process_time() - started
