"""Compilation of hot loops: numba, cached on disk, IEEE arithmetic (no fastmath)."""

from collections.abc import Callable
from typing import Any, cast

import numba

from oracle_pipeline.bags.jit import jit, jit_unchecked

__all__ = ["elementwise", "jit", "jit_unchecked"]


def elementwise(function: Callable[..., float]) -> Callable[..., Any]:
    """Compile a function of numbers, as ``jit`` does, into one of numbers or arrays of them."""
    vectorize: Any = numba.vectorize  # has no types
    return cast(Callable[..., Any], vectorize(cache=True)(function))
