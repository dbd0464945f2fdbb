"""The operations of an expression."""

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    # The operators of NumPy's scalars round differently from its loops over arrays.
    ast.FloorDiv: np.floor_divide,
    ast.Mod: np.remainder,
    ast.Pow: np.power,
}
COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge,
}  # fmt: skip
LOGIC: Mapping[type[ast.boolop], Callable[[Any, Any], Any]] = {
    ast.And: operator.and_,
    ast.Or: operator.or_,
}
UNARY: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: np.logical_not,
}


def int64(value: Any) -> Any:
    """Convert integers of any type to int64; larger ones wrap."""
    if isinstance(value, np.ndarray):
        return value.astype(np.int64, copy=False)
    return np.int64((int(value) + 2**63) % 2**64 - 2**63)


def float64s(values: Any) -> Any:
    """Convert numbers of any type to float64."""
    return np.asarray(values, np.float64)


def element(values: Sequence[Any], index: Any, missing: Any) -> Any:
    """Return the element at an index; ``missing`` outside the bounds."""
    return values[int(index)] if 0 <= index < len(values) else missing


def elements(values: Any, index: NDArray[Any], missing: Any) -> NDArray[Any]:
    """Return the elements at indices; ``missing`` for those outside the bounds."""
    if len(values) == 0:
        return np.full(index.shape, missing)
    inside = (index >= 0) & (index < len(values))
    if inside.all():
        return np.asarray(values).take(index.astype(np.int64, copy=False))
    places = np.where(inside, index, 0).astype(np.int64, copy=False)
    return np.where(inside, np.asarray(values).take(places), missing)
