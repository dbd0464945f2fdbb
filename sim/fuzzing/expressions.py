"""Expressions of the scenario language: parsed, checked against types, compiled to closures.

The text has Python's expression grammar, of which a closed list of nodes is accepted. This module
defines what they mean; Python never evaluates the text. Every expression is total: it terminates,
costs at most ``cost``, and has a value of its type for any data.

Numbers are int64, which wraps, and float64, by IEEE 754: ``/`` and ``**`` give float64, a whole
number divided by 0 with ``//`` or ``%`` is 0. An element outside an array's bounds, or a
missing row of a table, is NaN, 0, false, the empty text or a record of these.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim.fuzzing.expression_compiler import MAX_OPERATIONS, Evaluate, ExpressionCompiler
from sim.fuzzing.grammar import parse
from sim.fuzzing.scopes import Scope
from sim.fuzzing.value_types import Type


@dataclass(frozen=True, slots=True, eq=False)
class Expression:
    """A compiled expression.

    Parameters
    ----------
    text
        As it was written.
    type
        Of its value; numbers are ``int64`` or ``float64``.
    vector
        Whether it gives one value per element: an array as long as the scope's vectors.
    cost
        Elements that one evaluation computes, at most.
    names
        The names it uses, without ``fn``; with ``DRAWS`` if it draws.
    operations
        Number of its operations, including those of the functions that it calls.
    """

    text: str
    type: Type
    vector: bool
    cost: int
    names: frozenset[str]
    operations: int
    _run: Evaluate = field(repr=False)

    def __call__(self, env: Mapping[str, Any]) -> Any:
        """Return the value; NumPy's ``errstate`` decides about warnings of NaN and overflow.

        Parameters
        ----------
        env
            A value for each name of the scope. If the expression draws, ``env["rng"]`` is a
            function from the place of a draw to its generator:
            ``functools.partial(draws.generator, message, operation)``.

        Returns
        -------
        bool, int, float, str, ndarray, record, array or table
            An array if ``vector``, else one value.
        """
        value = self._run(dict(env))
        if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
            return value.item()
        return value


def compile_expression(text: str, scope: Scope, *, elements: int = 1) -> Expression:
    """Check and compile an expression; nothing of it is evaluated.

    Parameters
    ----------
    text
        The expression.
    scope
        Names that it may use.
    elements
        Largest length of the scope's vectors, for the cost.

    Raises
    ------
    ExpressionError
        If it is not valid in the language, or its types do not fit.
    """
    vectors = {name: name in scope.vectors for name in scope.locals}
    compiler = ExpressionCompiler(text, scope, scope.locals, vectors, elements)
    node = compiler.visit(parse(text))
    return Expression(
        text=text.strip(),
        type=node.type,
        vector=node.vector,
        cost=node.cost,
        names=frozenset(compiler.used),
        operations=MAX_OPERATIONS - compiler.budget[0],
        _run=node.run,
    )
