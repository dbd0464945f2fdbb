"""Compilation of hot loops: numba, cached on disk, IEEE arithmetic (no fastmath)."""

import importlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any, ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")

_BLAS = "scipy.linalg.cython_blas"

_compiled: list[Any] = []  # numba's functions, which have no types


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` on first call and keep the machine code for the next process."""
    return cast(Callable[P, R], _known(numba.njit(cache=True)(function)))


def jit_unchecked(function: Callable[P, R]) -> Callable[P, R]:
    """Compile as `jit` does, but division by zero gives ``inf`` or NaN, as in numpy.

    Without the check, a loop that only computes takes several numbers at a time.
    """
    compiled = _known(numba.njit(cache=True, error_model="numpy")(function))
    return cast(Callable[P, R], compiled)


def load_kept() -> None:
    """Load the kept machine code of all imported modules, for the processes forked from this one.

    The code of a function holds that of the functions which it calls; these are left out, as is
    what another kind of processor has kept.
    """
    called = {id(other) for function in _compiled for other in _named_in(function.py_func)}
    for function in _compiled:
        if id(function) in called:
            continue
        processor = function.targetctx.codegen().magic_tuple()
        for signature, kept_by, _ in function._cache._cache_file._load_index():
            if kept_by == processor:
                function.compile(signature)


def _named_in(function: Any) -> list[Any]:
    """Return the values of the global names that a function uses."""
    return [function.__globals__.get(name) for name in function.__code__.co_names]


def _known(function: Any) -> Any:
    _compiled.append(function)
    return function


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
