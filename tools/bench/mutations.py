"""Mutants of a module: its syntax tree with one node changed.

=============  =============================================================================
operator       what it changes
=============  =============================================================================
``constant``   a number is doubled or halved, an integer below 10 is one more or one less, a
               truth value is negated
``sign``       a sum becomes a difference, or the other way round; a minus is left out
``condition``  a comparison or a test is negated, the limit of a comparison is moved to the
               other side, ``and`` becomes ``or``, or the other way round
``stale``      an attribute gets the value that was meant for it the time before
``dropped``    an assignment to an attribute, or an augmented one (``+=``), is left out
=============  =============================================================================

Indices, annotations, decorators and the text of errors stay as they are. The last two operators
change attributes that ``__init__`` has set, outside of it.
"""

import ast
import copy
from collections.abc import Callable, Iterator, Mapping
from itertools import cycle
from typing import Any, NamedTuple, TypeAlias

import numpy as np

#: Takes a node and the attributes that its object has; returns what may stand in its place.
Operator: TypeAlias = Callable[[ast.AST, frozenset[str]], list[ast.AST]]

_SMALL = 10  # integers below it change by one
_ASIDE = frozenset({"annotation", "returns", "decorator_list", "bases", "slice", "exc"})
_NEGATED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn,
}  # fmt: skip
_NEGATED |= {after: before for before, after in _NEGATED.items()}
_MOVED: dict[type[ast.cmpop], type[ast.cmpop]] = {ast.Lt: ast.LtE, ast.Gt: ast.GtE}
_MOVED |= {after: before for before, after in _MOVED.items()}
_OTHER_SIGN: dict[type[ast.operator], type[ast.operator]] = {ast.Add: ast.Sub, ast.Sub: ast.Add}


class Mutant(NamedTuple):
    """One change of one module."""

    module: str  # dotted name
    line: int
    operator: str
    node: int  # its number, in the order of `_nodes`
    variant: int  # which of those that the operator offers
    before: str
    after: str

    @property
    def name(self) -> str:
        """Module, line and operator, with what tells it from others there."""
        module, variant = self.module.rpartition(".")[2], "ab"[self.variant]
        return f"{module}-{self.line}-{self.operator}-{self.node}{variant}"


def drawn(sources: Mapping[str, str], each: int, rng: np.random.Generator) -> list[Mutant]:
    """Return mutants of modules: for each operator as many, spread over the modules.

    Parameters
    ----------
    sources
        Source code by dotted name.
    each
        How many mutants of each operator; fewer if there are not so many.
    rng
        Draws the order of modules, and nodes in each.
    """
    known = {name: mutants(name, sources[name]) for name in sorted(sources)}
    chosen: list[Mutant] = []
    for operator in OPERATORS:
        left = {}
        for name in rng.permutation(list(known)).tolist():
            of_module = [mutant for mutant in known[name] if mutant.operator == operator]
            if of_module:
                left[name] = [of_module[n] for n in rng.permutation(len(of_module))]
        number = min(each, sum(map(len, left.values())))
        turns = cycle(left.values())
        while number:
            if of_module := next(turns):
                chosen.append(of_module.pop())
                number -= 1
    return chosen


def mutants(module: str, source: str) -> list[Mutant]:
    """Return all mutants of a module."""
    return [
        Mutant(module, node.lineno, operator, number, variant, _outline(node), _outline(after))
        for number, (node, attributes) in enumerate(_nodes(ast.parse(source)))
        for operator, change in OPERATORS.items()
        for variant, after in enumerate(change(node, attributes))
    ]


def _outline(node: ast.AST) -> str:
    """Return the first line of a node's source."""
    return ast.unparse(node).partition("\n")[0]


def mutated(source: str, mutant: Mutant) -> ast.Module:
    """Return the syntax tree of a module with the change of a mutant."""
    tree = ast.parse(source)
    node, attributes = list(_nodes(tree))[mutant.node]
    after = OPERATORS[mutant.operator](node, attributes)[mutant.variant]
    _Replacement(node, ast.copy_location(after, node)).visit(tree)
    return ast.fix_missing_locations(tree)


class _Replacement(ast.NodeTransformer):
    def __init__(self, before: ast.AST, after: ast.AST) -> None:
        self._before, self._after = before, after

    def visit(self, node: ast.AST) -> Any:
        return self._after if node is self._before else self.generic_visit(node)


def _nodes(node: ast.AST, attributes: frozenset[str] = frozenset()) -> Iterator[tuple[Any, Any]]:
    """Yield the statements and expressions that may be changed, with the object's attributes."""
    if isinstance(node, ast.ClassDef):
        attributes = _initialised(node)
    elif isinstance(node, ast.FunctionDef) and node.name == "__init__":
        attributes = frozenset()
    for name, value in ast.iter_fields(node):
        if name in _ASIDE:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.stmt | ast.expr):
                yield child, attributes
            if isinstance(child, ast.AST):
                yield from _nodes(child, attributes)


def _initialised(of_class: ast.ClassDef) -> frozenset[str]:
    """Return the attributes that a class's own ``__init__`` sets."""
    return frozenset(
        node.attr
        for method in of_class.body
        if isinstance(method, ast.FunctionDef) and method.name == "__init__"
        for node in ast.walk(method)
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
    )


def _constant(node: ast.AST, _: frozenset[str]) -> list[ast.AST]:
    match node:
        case ast.Constant(value=bool(value)):
            values: list[Any] = [not value]
        case ast.Constant(value=int(value)):
            is_small = value < _SMALL
            values = [value + 1, value - 1] if is_small else [2 * value, value // 2]
        case ast.Constant(value=float(value)):
            values = [2.0 * value, value / 2.0] if value else [1.0]
        case _:
            values = []
    return [ast.Constant(each) for each in values]


def _sign(node: ast.AST, _: frozenset[str]) -> list[ast.AST]:
    match node:
        case ast.BinOp() | ast.AugAssign() if type(node.op) in _OTHER_SIGN:
            return [_with(node, op=_OTHER_SIGN[type(node.op)]())]
        case ast.UnaryOp(op=ast.USub()):
            return [node.operand]
    return []


def _condition(node: ast.AST, _: frozenset[str]) -> list[ast.AST]:
    match node:
        case ast.Compare(ops=[op]):
            tables = [each for each in (_NEGATED, _MOVED) if type(op) in each]
            return [_with(node, ops=[each[type(op)]()]) for each in tables]
        case ast.BoolOp():
            return [_with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())]
        case ast.UnaryOp(op=ast.Not()):
            return [node.operand]
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            if isinstance(test, ast.Name | ast.Attribute | ast.Call):
                return [_with(node, test=ast.UnaryOp(ast.Not(), test))]
    return []


def _stale(node: ast.AST, attributes: frozenset[str]) -> list[ast.AST]:
    match node:
        case ast.Assign(targets=[ast.Attribute(value=ast.Name(id="self"), attr=name)]):
            if name in attributes:
                value = ast.unparse(node.value)
                kept = f"getattr(self, '{name}_next', self.{name})"
                return [*ast.parse(f"self.{name}, self.{name}_next = {kept}, {value}").body]
    return []


def _dropped(node: ast.AST, attributes: frozenset[str]) -> list[ast.AST]:
    match node:
        case ast.AugAssign():
            return [ast.Pass()]
        case ast.Assign(targets=[ast.Attribute(value=ast.Name(id="self"), attr=name)]):
            return [ast.Pass()] if name in attributes else []
    return []


def _with(node: ast.AST, **fields: Any) -> ast.AST:
    """Return a copy of a node with other fields."""
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


OPERATORS: Mapping[str, Operator] = {
    "constant": _constant,
    "sign": _sign,
    "condition": _condition,
    "stale": _stale,
    "dropped": _dropped,
}
