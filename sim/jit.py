"""The one way hot loops are compiled: numba, cached on disk, IEEE arithmetic (no fastmath)."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` on first call and keep the machine code for the next process."""
    return cast(Callable[P, R], numba.njit(cache=True)(function))


def elementwise(function: Callable[..., float]) -> Callable[..., Any]:
    """Compile a function of numbers, as ``jit`` does, into one of numbers or arrays of them."""
    vectorize: Any = numba.vectorize  # has no types
    return cast(Callable[..., Any], vectorize(cache=True)(function))
