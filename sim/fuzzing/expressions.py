"""Expressions of the scenario language: parsed, checked against types, compiled to closures.

The text has Python's expression grammar, of which a closed list of nodes is accepted. This module
defines what they mean; Python never evaluates the text. Every expression is total: it terminates,
costs at most ``cost``, and has a value of its type for any data.

Numbers are int64, which wraps, and float64, by IEEE 754: ``/`` and ``**`` give float64, a whole
number divided by 0 with ``//`` or ``%`` is 0. An element outside an array's bounds, or a
missing row of a table, is NaN, 0, false, the empty text or a record of these.
"""

import ast
import functools
import itertools
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from sim.fuzzing import arithmetic
from sim.fuzzing import value_types as vt
from sim.fuzzing.functions import BUILTINS, CONSTANTS, Builtin, promoted
from sim.fuzzing.grammar import FUNCTIONS, called_function, error_at, listed, parse
from sim.fuzzing.scopes import DRAWS, Function, Scope

MAX_DEPTH = 40  # operations inside operations, functions included
MAX_OPERATIONS = 2000  # of one expression, functions included

Frame = dict[str, Any]  # values of names, and results of calls
Evaluate = Callable[[Frame], Any]


@dataclass(frozen=True, slots=True)
class _Node:
    """A compiled part of an expression."""

    type: vt.Type
    vector: bool
    cost: int
    run: Evaluate


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
    type: vt.Type
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
    compiler = _Compiler(text, scope, scope.locals, vectors, elements)
    node = compiler.visit(parse(text))
    return Expression(
        text=text.strip(), type=node.type, vector=node.vector, cost=node.cost,
        names=frozenset(compiler.used), operations=MAX_OPERATIONS - compiler.budget[0],
        _run=node.run,
    )  # fmt: skip


class _Compiler(ast.NodeVisitor):
    """Compiles one text; each function that it calls gets a separate compiler.

    Parameters
    ----------
    text
        The text, for error messages.
    scope
        Its names, functions and vectors; locals are given by the next two parameters.
    local
        The types of names that only this text can use.
    vectors
        Which of them are vectors.
    elements
        Largest length of vectors.
    depth
        Nesting depth of the call.
    budget
        Number of operations left, in a list of one element that all compilers share.
    """

    def __init__(
        self,
        text: str,
        scope: Scope,
        local: Mapping[str, vt.Type],
        vectors: Mapping[str, bool],
        elements: int,
        depth: int = 0,
        budget: list[int] | None = None,
    ) -> None:
        self._text = text
        self._scope = scope
        self._names = {**scope.names, **local}
        self._vectors = vectors
        self._elements = elements
        self._depth = depth
        self.budget = [MAX_OPERATIONS] if budget is None else budget
        self._places = itertools.count()
        self.used: set[str] = set()

    def visit(self, node: ast.AST) -> _Node:
        """Compile one node, within the bounds."""
        self._depth += 1
        self.budget[0] -= 1
        if self._depth > MAX_DEPTH:
            self._refuse(node, f"nested deeper than {MAX_DEPTH} operations, functions included")
        if self.budget[0] < 0:
            self._refuse(node, f"more than {MAX_OPERATIONS} operations, functions included")
        compiled: _Node = super().visit(node)
        self._depth -= 1
        return compiled

    def visit_Constant(self, node: ast.Constant) -> _Node:
        """Compile a number, a text, True or False."""
        if not isinstance(node.value, bool | int | float | str):
            self._refuse(node, "a constant is a number, a text, True or False")
        return self._constant(node.value)

    def visit_Name(self, node: ast.Name) -> _Node:
        """Compile a name of the scope."""
        name = node.id
        if name in CONSTANTS:
            return self._constant(CONSTANTS[name])
        if name not in self._names:
            self._refuse(node, f"{name!r} is unknown; known are {listed(self._names)}")
        self.used.add(name)
        vector = self._vectors.get(name, False)
        cost = self._elements if vector else 1
        return self._load(self._names[name], vector, cost, operator.itemgetter(name))

    def visit_Attribute(self, node: ast.Attribute) -> _Node:
        """Compile a field of a record."""
        if isinstance(node.value, ast.Name) and node.value.id == FUNCTIONS:
            self._refuse(node, f"a function is called: fn.{node.attr}(...)")
        record = self.visit(node.value)
        if not isinstance(record.type, vt.Record):
            self._refuse(node, f"{record.type} has no fields")
        if node.attr not in record.type.fields:
            fields = listed(record.type.fields)
            self._refuse(node, f"{record.type} has no field {node.attr!r}; it has {fields}")
        getter = operator.attrgetter if isinstance(record.type, vt.Message) else operator.itemgetter
        read, kind = getter(node.attr), record.type.fields[node.attr]
        return self._load(kind, False, record.cost + 1, lambda frame: read(record.run(frame)))

    def visit_Subscript(self, node: ast.Subscript) -> _Node:
        """Compile an element of an array or a row of a table."""
        whole, index = self.visit(node.value), self.visit(node.slice)
        cost = whole.cost + index.cost + (self._elements if index.vector else 1)
        if isinstance(whole.type, vt.Table) and isinstance(index.type, vt.Text):
            row = whole.type.row
            no_row = vt.missing(row)

            def read_row(frame: Frame) -> Any:
                return whole.run(frame).get(vt.strip_padding(index.run(frame)), no_row)

            return self._load(row, False, cost, read_row)
        if not isinstance(whole.type, vt.Array) or not isinstance(index.type, vt.Number):
            self._refuse(node, f"{whole.type} has no element [{index.type}]")
        element = whole.type.element
        if index.vector and not isinstance(element, vt.Number | vt.Boolean):
            self._refuse(node, f"one {element} at a time: the index must be one number")
        pick = arithmetic.elements if index.vector else arithmetic.element
        absent = vt.missing(element)

        def read(frame: Frame) -> Any:
            return pick(whole.run(frame), index.run(frame), absent)

        return self._load(element, index.vector, cost, read)

    def visit_BinOp(self, node: ast.BinOp) -> _Node:
        """Compile arithmetic."""
        parts = [self.visit(node.left), self.visit(node.right)]
        self._expect(node, vt.Number, parts)
        kind = promoted([part.type for part in parts])
        if isinstance(node.op, ast.Div | ast.Pow):
            kind = vt.FLOAT
        left, right = (self._as(kind, part) for part in parts)
        compute = arithmetic.ARITHMETIC[type(node.op)]
        return self._node(kind, parts, lambda frame: compute(left.run(frame), right.run(frame)))

    def visit_UnaryOp(self, node: ast.UnaryOp) -> _Node:
        """Compile a sign or ``not``."""
        part = self.visit(node.operand)
        self._expect(node, vt.Boolean if isinstance(node.op, ast.Not) else vt.Number, [part])
        compute = arithmetic.UNARY[type(node.op)]
        return self._node(part.type, [part], lambda frame: compute(part.run(frame)))

    def visit_Compare(self, node: ast.Compare) -> _Node:
        """Compile a comparison, or a chain of them; each value is computed once."""
        values = [self.visit(part) for part in (node.left, *node.comparators)]
        pairs = zip(itertools.pairwise(values), node.ops, strict=True)
        compare = [self._comparison(node, op, *pair) for pair, op in pairs]

        def run(frame: Frame) -> Any:
            found = [value.run(frame) for value in values]
            results = [check(a, b) for check, a, b in zip(compare, found, found[1:], strict=False)]
            return functools.reduce(operator.and_, results)

        return self._node(vt.BOOLEAN, values, run, work=len(compare))

    def visit_BoolOp(self, node: ast.BoolOp) -> _Node:
        """Compile ``and`` or ``or``; all sides are evaluated, which has no visible effect."""
        parts = [self.visit(part) for part in node.values]
        self._expect(node, vt.Boolean, parts)
        combine = arithmetic.LOGIC[type(node.op)]
        return self._node(
            vt.BOOLEAN,
            parts,
            lambda frame: functools.reduce(combine, [p.run(frame) for p in parts]),
        )

    def visit_IfExp(self, node: ast.IfExp) -> _Node:
        """Compile a choice: per element if anything is a vector, else of one value."""
        test, then, other = (self.visit(part) for part in (node.test, node.body, node.orelse))
        self._expect(node.test, vt.Boolean, [test])
        kind = self._common(node, then, other)
        yes, no = self._as(kind, then), self._as(kind, other)
        parts = [test, then, other]
        if any(part.vector for part in parts):
            if not isinstance(kind, vt.Number | vt.Boolean):
                self._refuse(node, f"one {kind} at a time: the condition must be one boolean")
            return self._node(
                kind, parts, lambda frame: np.where(test.run(frame), yes.run(frame), no.run(frame))
            )
        return self._node(kind, parts, lambda frame: (yes if test.run(frame) else no).run(frame))

    def visit_List(self, node: ast.List | ast.Tuple) -> _Node:
        """Compile a list of numbers, or of lists of numbers that are equally long."""
        parts = [self.visit(part) for part in node.elts]
        kinds = [vt.listable(part.type) for part in parts]
        kind = kinds[0] if kinds else None
        if kind is None or kinds != [kind] * len(kinds) or any(part.vector for part in parts):
            self._refuse(node, "a list has numbers, or lists of equally many numbers")
        return self._node(
            vt.Array(kind, len(parts), fixed=True),
            parts,
            lambda frame: np.array([part.run(frame) for part in parts], np.float64),
        )

    visit_Tuple = visit_List  # noqa: N815

    def visit_Call(self, node: ast.Call) -> _Node:
        """Compile a call of a built-in or of a function of the scenario."""
        arguments = [self.visit(argument) for argument in node.args]
        if isinstance(node.func, ast.Name):
            return self._call_builtin(node, BUILTINS[node.func.id], arguments)
        name = called_function(node) or ""
        if name not in self._scope.functions:
            self._refuse(node, f"fn.{name} is unknown; known are {listed(self._scope.functions)}")
        return self._call_function(node, self._scope.functions[name], arguments)

    def _call_builtin(self, node: ast.Call, builtin: Builtin, arguments: list[_Node]) -> _Node:
        types = [argument.type for argument in arguments]
        kind = builtin.result(types)
        if kind is None:
            given = ", ".join(map(str, types))
            self._refuse(node, f"{builtin.usage} cannot take ({given})")
        if not builtin.elementwise and any(argument.vector for argument in arguments):
            self._refuse(node, f"{builtin.usage} takes one value, not one per element")
        if kind != vt.INTEGER:
            arguments = [
                self._as(vt.FLOAT, argument) if argument.type == vt.INTEGER else argument
                for argument in arguments
            ]
        if builtin.draws:
            return self._draw(kind, builtin, arguments)
        compute = builtin.evaluate
        absent = vt.missing(kind) if isinstance(kind, vt.Record) else None

        def run(frame: Frame) -> Any:
            value = compute(*[argument.run(frame) for argument in arguments])
            return absent if value is None else value

        return self._node(kind, arguments, run, work=builtin.work(types))

    def _draw(self, kind: vt.Type, builtin: Builtin, arguments: list[_Node]) -> _Node:
        """Draw once per element where the scope has vectors, whatever the arguments are."""
        place = next(self._places)
        vectors = self._scope.vectors
        self.used.add(DRAWS)

        def run(frame: Frame) -> Any:
            n = len(frame[vectors[0]]) if vectors else None
            values = [argument.run(frame) for argument in arguments]
            return builtin.evaluate(frame[DRAWS](place), n, *values)

        return self._node(kind, arguments, run, vector=bool(vectors))

    def _call_function(self, node: ast.Call, function: Function, arguments: list[_Node]) -> _Node:
        params = function.params
        if len(arguments) != len(params):
            self._refuse(
                node, f"expected the arguments ({', '.join(params)}), found {len(arguments)}"
            )
        compiler = _Compiler(
            function.text,
            self._scope,
            {name: argument.type for name, argument in zip(params, arguments, strict=True)},
            {name: argument.vector for name, argument in zip(params, arguments, strict=True)},
            self._elements,
            self._depth,
            self.budget,
        )
        body = compiler.visit(parse(function.text))
        seen = sorted(compiler.used.difference(params))
        self.used.update(seen)
        call = ast.dump(node)  # the same call in one evaluation gives the same value

        def run(frame: Frame) -> Any:
            if call not in frame:
                inner = {name: frame[name] for name in seen}
                inner.update(zip(params, [part.run(frame) for part in arguments], strict=True))
                frame[call] = body.run(inner)
            return frame[call]

        return _Node(body.type, body.vector, body.cost + sum(a.cost for a in arguments), run)

    def _comparison(
        self, node: ast.Compare, op: ast.cmpop, one: _Node, other: _Node
    ) -> Callable[[Any, Any], Any]:
        kind = self._common(node, one, other)
        compare = arithmetic.COMPARISONS[type(op)]
        match kind:
            case vt.Array() | vt.Record() | vt.Table():
                self._refuse(node, f"{kind} cannot be compared")
            case vt.Boolean() | vt.Text() if not isinstance(op, ast.Eq | ast.NotEq):
                self._refuse(node, f"{kind} can only be compared by == and !=")
            case vt.Text():
                return lambda a, b: compare(vt.strip_padding(a), vt.strip_padding(b))
            case vt.Number("float64") if one.type != other.type:
                return lambda a, b: compare(np.float64(a), np.float64(b))
        return compare

    def _common(self, node: ast.AST, one: _Node, other: _Node) -> vt.Type:
        """Return the type that holds the values of both."""
        match one.type, other.type:
            case vt.Number(), vt.Number():
                return promoted([one.type, other.type])
            case vt.Text() as a, vt.Text() as b:
                return vt.Text(max(a.max_len, b.max_len))
        if one.type != other.type:
            self._refuse(node, f"{one.type} does not go with {other.type}")
        return one.type

    def _as(self, kind: vt.Type, part: _Node) -> _Node:
        """Convert integers to float64 if ``kind`` is float64."""
        if kind != vt.FLOAT or part.type == vt.FLOAT:
            return part
        return _Node(vt.FLOAT, part.vector, part.cost, lambda frame: np.float64(part.run(frame)))

    def _constant(self, value: bool | int | float | str) -> _Node:
        match value:
            case bool():
                return self._node(vt.BOOLEAN, [], lambda _: value)
            case int():
                whole = np.int64(value)
                return self._node(vt.INTEGER, [], lambda _: whole)
            case float():
                real = np.float64(value)
                return self._node(vt.FLOAT, [], lambda _: real)
            case str():
                return self._node(vt.Text(len(value)), [], lambda _: value)

    def _load(self, kind: vt.Type, vector: bool, cost: int, read: Evaluate) -> _Node:
        """Load a value from the environment, numbers as int64 or float64."""
        convert: Callable[[Any], Any]
        match kind:
            case vt.Number() if kind.is_integer:
                kind, convert = vt.INTEGER, arithmetic.int64
            case vt.Number():
                kind, convert = vt.FLOAT, arithmetic.float64s if vector else np.float64
            case vt.Boolean():
                convert = np.bool_
            case _:
                return _Node(kind, vector, cost, read)
        return _Node(kind, vector, cost, lambda frame: convert(read(frame)))

    def _node(
        self,
        kind: vt.Type,
        parts: Sequence[_Node],
        run: Evaluate,
        *,
        vector: bool = False,
        work: int = 1,
    ) -> _Node:
        vector = vector or any(part.vector for part in parts)
        width = self._elements if vector else 1
        return _Node(kind, vector, sum(part.cost for part in parts) + width * work, run)

    def _expect(
        self, node: ast.AST, kind: type[vt.Number] | type[vt.Boolean], parts: Sequence[_Node]
    ) -> None:
        for part in parts:
            if not isinstance(part.type, kind):
                expected = "numbers" if kind is vt.Number else "booleans"
                self._refuse(node, f"expected {expected}, found {part.type}")

    def _refuse(self, node: ast.AST, what: str) -> NoReturn:
        raise error_at(self._text, node, what)
