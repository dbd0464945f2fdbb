"""Compilation of hot loops: numba, cached on disk, IEEE arithmetic (no fastmath)."""

import importlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")

_BLAS = "scipy.linalg.cython_blas"


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` on first call and keep the machine code for the next process."""
    return cast(Callable[P, R], numba.njit(cache=True)(function))


def jit_unchecked(function: Callable[P, R]) -> Callable[P, R]:
    """Compile as `jit` does, but division by zero gives ``inf`` or NaN, as in numpy.

    Without the check, a loop that only computes takes several numbers at a time.
    """
    return cast(Callable[P, R], numba.njit(cache=True, error_model="numpy")(function))


def _load_without_scipy() -> None:
    """Import numba's functions of arrays, which look for SciPy, as if it were not installed.

    They import ``scipy.linalg`` only to know that it is there, which takes as long as all of
    numba. A loop with linear algebra gets it all the same, when it is compiled.
    """
    if _BLAS not in sys.modules:
        sys.modules[_BLAS] = cast(ModuleType, None)  # which is how Python marks what is missing
        try:
            importlib.import_module("numba.np.arraymath")
        finally:
            del sys.modules[_BLAS]


_load_without_scipy()
