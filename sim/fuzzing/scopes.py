"""The scope of an expression: the values and functions that it may name."""

import ast
import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

from sim.fuzzing import grammar
from sim.fuzzing.functions import BUILTINS, CONSTANTS
from sim.fuzzing.value_types import Boolean, Number, Type

DRAWS = "rng"  # name of the random generators in an environment

_RESERVED = frozenset({DRAWS, grammar.FUNCTIONS, *BUILTINS, *CONSTANTS})


@dataclass(frozen=True, slots=True)
class Function:
    """A function of the scenario: one expression over its parameters, pure, typed by each call.

    Raises
    ------
    ExpressionError
        If the text is not an expression, draws random numbers, or a parameter has a bad name.
    """

    params: tuple[str, ...]
    text: str

    def __post_init__(self) -> None:
        grammar.check_names(self.params, _RESERVED)
        for node in ast.walk(grammar.parse(self.text)):
            match node:
                case ast.Call(ast.Name(name)) if BUILTINS[name].draws:
                    raise grammar.error_at(
                        self.text,
                        node,
                        f"a function cannot draw; pass the value of {name} as an argument",
                    )


@dataclass(frozen=True, slots=True)
class Scope:
    """The names that an expression may use.

    Parameters
    ----------
    names
        Names for everything, functions too: ``msg``, ``p``, ``c``, ``state``, ``src``, ``t`` ...
    functions
        Functions that may be called as ``fn.<name>(...)``.
    locals
        Names for this expression only: loop variables and ``let``.
    vectors
        Those of the locals (numbers or booleans) that hold one value per element, as arrays.

    Raises
    ------
    ExpressionError
        If a name is reserved, private or given twice, or if functions call each other recursively.
    """

    names: Mapping[str, Type]
    functions: Mapping[str, Function] = field(default_factory=dict)
    locals: Mapping[str, Type] = field(default_factory=dict)
    vectors: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        grammar.check_names([*self.names, *self.locals], _RESERVED)
        grammar.check_names(self.functions)
        for name in self.vectors:
            if not isinstance(self.locals.get(name), Number | Boolean):
                raise grammar.ExpressionError(
                    f"{name!r} is no local number or boolean to hold a vector."
                )
        _refuse_rings(tuple(self.functions.items()))


@functools.lru_cache(maxsize=64)  # a scenario has many scopes and the same functions in each
def _refuse_rings(functions: tuple[tuple[str, Function], ...]) -> None:
    calls = {
        name: filter(None, map(grammar.called_function, ast.walk(grammar.parse(function.text))))
        for name, function in functions
    }
    try:
        TopologicalSorter(calls).prepare()
    except CycleError as error:
        ring = " calls ".join(f"fn.{name}" for name in error.args[1])
        raise grammar.ExpressionError(
            f"Functions cannot call themselves, but {ring}; write the expression out."
        ) from None
