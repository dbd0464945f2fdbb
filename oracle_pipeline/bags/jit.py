"""Compilation of hot loops: numba, cached on disk, IEEE arithmetic (no fastmath)."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` on first call and keep the machine code for the next process."""
    return cast(Callable[P, R], numba.njit(cache=True)(function))


def jit_unchecked(function: Callable[P, R]) -> Callable[P, R]:
    """Compile as `jit` does, but division by zero gives ``inf`` or NaN, as in numpy.

    Without the check, a loop that only computes takes several numbers at a time.
    """
    return cast(Callable[P, R], numba.njit(cache=True, error_model="numpy")(function))


def calls_from_c(signature: str) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function that C code calls, without Python: its ``address`` is a pointer to it."""
    return cast(Callable[[Callable[..., Any]], Any], numba.cfunc(signature, cache=True))
