"""The one way hot loops are compiled: numba, cached on disk, IEEE arithmetic (no fastmath)."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` on first call and keep the machine code for the next process."""
    return cast(Callable[P, R], numba.njit(cache=True)(function))
