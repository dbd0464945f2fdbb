"""Compilation of hot loops: numba, cached on disk, IEEE arithmetic (no fastmath)."""

import sys
from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def _load_without_scipy() -> None:
    """Load numba's array functions, but not SciPy's BLAS, for which they ask.

    That takes as long as numba itself, and no loop here multiplies matrices. Loops of others that
    do still find it: numba asks again when it compiles them.
    """
    blas = "scipy.linalg.cython_blas"
    if blas in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules[blas] = None  # type: ignore[assignment]  # an import of it fails
    try:
        import numba.np.arraymath
    finally:
        del sys.modules[blas]
    vars(numba.np.arraymath)["_HAVE_BLAS"] = True


_load_without_scipy()


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` on first call and keep the machine code for the next process."""
    return cast(Callable[P, R], numba.njit(cache=True)(function))


def jit_unchecked(function: Callable[P, R]) -> Callable[P, R]:
    """Compile as `jit` does, but division by zero gives ``inf`` or NaN, as in numpy.

    Without the check, a loop that only computes takes several numbers at a time.
    """
    return cast(Callable[P, R], numba.njit(cache=True, error_model="numpy")(function))
