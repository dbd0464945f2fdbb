"""The context of compilation: scope, message types, and the fields that operators change.

Everything is checked here against the types of the messages, and errors name the place in the file.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from sim.fuzzing.expressions import compile_expression
from sim.fuzzing.fields import Convert, Field, RefusedMessage, converter, difference
from sim.fuzzing.grammar import ExpressionError
from sim.fuzzing.scenario import Key, Scenario, ScenarioError, together
from sim.fuzzing.scopes import Scope
from sim.fuzzing.step import Step, Term
from sim.fuzzing.value_types import INTEGER, Array, Boolean, Message, Number, Record, Text, Type

Spec = Mapping[str, Any]

MAX_OPERATIONS = 30_000  # of all expressions in a file, functions counted at each call


class TooMuchError(ScenarioError):
    """The limit of compilation is reached, so the search for faults ends."""


@dataclass(frozen=True, slots=True)
class Faults:
    """Gathers the faults of parts that do not depend on each other.

    Examples
    --------
    >>> faults = Faults()
    >>> for line in ("one", "two"):
    ...     with faults.gathered():
    ...         raise ScenarioError(line)
    >>> faults.end()
    Traceback (most recent call last):
    sim.fuzzing.scenario.ScenarioError: one
    two
    """

    _found: list[ScenarioError] = field(default_factory=list)

    @contextmanager
    def gathered(self) -> Iterator[None]:
        """Store the fault of one part, and continue after it."""
        try:
            yield
        except TooMuchError:
            raise
        except ScenarioError as error:
            self._found.append(error)

    def end(self) -> None:
        """Refuse the scenario if there was a fault; called before a stage that needs all parts.

        Raises
        ------
        ScenarioError
            With a line for each of the first faults.
        """
        if self._found:
            raise together(self._found)


@dataclass(slots=True)
class OperationBudget:
    """The number of operations that may still be compiled for a file, which bounds the time."""

    left: int = MAX_OPERATIONS


class OperationNumbers(Iterator[int]):
    """Consecutive numbers of operations, from a given first one."""

    def __init__(self, upcoming: int) -> None:
        self.upcoming = upcoming

    def __next__(self) -> int:
        """Return the next one."""
        self.upcoming += 1
        return self.upcoming - 1


@dataclass(frozen=True, slots=True)
class CompileContext:
    """The context in which operators are compiled.

    Parameters
    ----------
    scenario
        For the places of errors.
    scope
        Names that expressions may use.
    root
        Type at which paths of fields begin.
    outputs
        Where messages can be emitted: name -> topic and type; the main output has no name.
    state
        Values that are kept from message to message.
    longest
        Elements that an array may have.
    numbers
        Of the operations, in the order of the document.
    budget
        Shared by all that is compiled for the file.
    faults
        Those of operators and actions, which do not depend on each other.

    Notes
    -----
    The size of an expression is limited, so the budget is exceeded by at most that size.
    """

    scenario: Scenario
    scope: Scope
    root: Message
    outputs: Mapping[str, tuple[str, Message]]
    state: Record
    longest: int
    numbers: OperationNumbers
    budget: OperationBudget
    faults: Faults

    def term(
        self, text: str | float, key: Key, expected: type | None = None, *, elements: int = 1
    ) -> Term:
        """Compile an expression; numbers and booleans stand for themselves."""
        try:
            expression = compile_expression(
                text if isinstance(text, str) else repr(text), self.scope, elements=elements
            )
        except ExpressionError as error:
            raise self.error(key, error) from error
        self.budget.left -= expression.operations
        if self.budget.left < 0:
            raise TooMuchError(
                str(
                    self.scenario.error(
                        key,
                        f"expected at most {MAX_OPERATIONS} operations in all expressions of the "
                        "file, functions counted at each call; split or simplify the file",
                    )
                )
            )
        if expected is not None and not isinstance(expression.type, expected):
            what = expected.__name__.lower()
            raise self.scenario.error(key, f"expected a {what}, found a {expression.type}")
        return Term(expression, next(self.numbers))

    def error(self, key: Key, error: ExpressionError) -> ScenarioError:
        """Return the error of an expression, with its place in the file."""
        return self.scenario.error(key, str(error).removesuffix("."))

    def condition(self, spec: Spec, key: Key) -> Term | None:
        """Compile ``when``; None without one."""
        return self.term(spec["when"], (*key, "when"), Boolean) if "when" in spec else None

    def let(
        self, spec: Spec, key: Key, *, elements: int = 1
    ) -> tuple["CompileContext", tuple[tuple[str, Term], ...]]:
        """Compile ``let``: each of its names is known to those below it and to the rest."""
        context, terms = self, []
        for name, text in spec.get("let", {}).items():
            place = (*key, "let", name)
            term = context.term(text, place, elements=elements)
            is_vector = term.expression.vector
            context = context.with_local(place, name, term.type, is_vector=is_vector)
            terms.append((name, term))
        return context, tuple(terms)

    def loop(self, spec: Spec, key: Key, element: Type) -> tuple["CompileContext", tuple[str, ...]]:
        """Compile ``as``: names of an element and of its index."""
        names = tuple(spec["as"])
        context = self
        for name, kind in zip(names, (element, INTEGER), strict=False):
            is_vector = isinstance(element, Number | Boolean)
            context = context.with_local((*key, "as"), name, kind, is_vector=is_vector)
        return context, names

    def with_local(self, key: Key, name: str, kind: Type, *, is_vector: bool) -> "CompileContext":
        """Return a context with further names for expressions."""
        if name in self.scope.locals:
            raise self.scenario.error(key, f"expected a new name, {name} is taken")
        vectors = (*self.scope.vectors, name) if is_vector else self.scope.vectors
        try:
            scope = dataclasses.replace(
                self.scope, locals={**self.scope.locals, name: kind}, vectors=vectors
            )
        except ExpressionError as error:
            raise self.error(key, error) from error
        return dataclasses.replace(self, scope=scope)

    def field(self, spec: Spec, key: Key) -> Field:
        """Return the field that a specification names."""
        return self.field_at(spec["field"], (*key, "field"), self.root)

    def field_at(self, path: str, key: Key, root: Message) -> Field:
        """Return the field at a path."""
        try:
            return Field.of(root, path)
        except LookupError as error:
            raise self.scenario.error(key, str(error.args[0])) from error

    def check_fits(self, value: Term, kind: Type, key: Key, place: str = "") -> None:
        """Refuse a value that cannot be stored as a type; ``place`` is the path of a field."""
        if not _fits(value.type, kind):
            where = f" for {place}" if place else ""
            raise self.scenario.error(key, f"expected a {kind}{where}, found a {value.type}")

    def width(self, kind: Type) -> int:
        """Return how many elements a value may have."""
        return min(kind.bound or self.longest, self.longest) if isinstance(kind, Array) else 1


@dataclass(frozen=True, slots=True)
class Target:
    """The field that an operator changes."""

    field: Field
    longest: int
    convert: Convert
    keep: bool  # keep numbers that are not finite

    @classmethod
    def of(cls, spec: Spec, key: Key, context: CompileContext) -> Self:
        """Return the target of a specification."""
        field = context.field(spec, key)
        convert = converter(field.type, spec.get("on_overflow", "wrap"))
        return cls(field, context.longest, convert, spec.get("nonfinite", "keep") == "keep")

    @classmethod
    def of_numbers(cls, spec: Spec, key: Key, context: CompileContext) -> Self:
        """Return the target of a specification that only numbers can meet."""
        target = cls.of(spec, key, context)
        if not isinstance(target.element, Number):
            raise context.scenario.error(
                (*key, "field"),
                f"expected a number or an array of numbers, {target.field.path} is a "
                f"{target.field.type}",
            )
        return target

    @property
    def element(self) -> Type:
        """The type of the field, or that of its elements."""
        kind = self.field.type
        return kind.element if isinstance(kind, Array) else kind

    def old(self, step: Step) -> Any:
        """Return the value of the field before the action."""
        value = self.field.read(step.original)
        if isinstance(self.field.type, Array) and len(value) > self.longest:
            raise RefusedMessage(
                f"{self.field.path} has {len(value)} elements, limits.array is {self.longest}"
            )
        return value

    def numbers(self, step: Step) -> tuple[Any, Any]:
        """Return the value before the action; arrays of numbers also as int64 or float64."""
        old = self.old(step)
        if isinstance(old, np.ndarray) and old.dtype.kind != "b":
            return old, old.astype(np.int64 if old.dtype.kind in "iu" else np.float64)
        return old, old

    def change(self, step: Step, old: Any, new: Any) -> None:
        """Replace the value, or a whole array."""
        new = self.convert(new, old)
        step.message = self.field.replaced(step.message, new)
        step.note(*difference(self.field.path, old, new))

    def change_numbers(self, step: Step, old: Any, new: Any) -> None:
        """Replace numbers, except those that are not finite and are kept."""
        if self.keep and isinstance(old, np.ndarray):
            new = np.where(np.isfinite(old), new, old)
        elif self.keep and not math.isfinite(old):
            new = old
        self.change(step, old, new)


def _fits(value: Type, target: Type) -> bool:
    """Return whether a value of one type can be stored as another."""
    match value, target:
        case (Number(), Number()) | (Boolean(), Boolean()) | (Text(), Text()):
            return True
        case Array(), Array():
            roomy = target.bound is None or (value.bound or math.inf) <= target.bound
            exact = value.fixed and value.bound == target.bound
            return _fits(value.element, target.element) and (exact if target.fixed else roomy)
        case Number() | Boolean(), Array():
            return _fits(value, target.element)
    return isinstance(value, Message) and value == target
