"""What operators are compiled with: the step a message is in, terms, and the fields they change.

Everything is checked here against the types of the messages, and errors name the place in the file.
"""

import dataclasses
import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

import numpy as np

from sim.fuzzing.expressions import (
    DRAWS,
    Expression,
    ExpressionError,
    Scope,
    compile_expression,
)
from sim.fuzzing.fields import Convert, Field, RefusedMessage, converter, difference
from sim.fuzzing.random import Draws
from sim.fuzzing.scenario import Key, Scenario, ScenarioError
from sim.fuzzing.values import INTEGER, Array, Boolean, Message, Number, Record, Text, Type

_BRANCH = 1 << 32  # the operations of one round of a loop, apart from those of the next

Spec = Mapping[str, Any]


@dataclass(slots=True)
class Step:
    """One message, or one beat of a timer, on its way through a scenario."""

    stamp_ns: int  # when it was published
    heard: int  # how many messages came before
    index: int  # what its draws go by
    draws: Draws
    env: dict[str, Any]  # the values of names
    header: Any  # for messages that are made; None if the type has none
    recent: Sequence[Any]  # what came last, this message included
    memory: dict[int, Any]  # of operators, from message to message
    original: Any = None  # the message, or element, as the action found it
    message: Any = None  # as far as it is changed
    dropped: bool = False
    delay_s: float = 0.0
    copies: int = 1
    spacing_s: float = 0.0
    emitted: list[Any] = field(default_factory=list)
    magnitude: float = 0.0
    notes: list[str] = field(default_factory=list)
    branch: int = 0

    def generator(self, operation: int, place: int = 0) -> np.random.Generator:
        """Return the generator of one draw."""
        return self.draws.generator(self.index, operation + self.branch * _BRANCH, place)

    def note(self, magnitude: float, text: str) -> None:
        """Keep what was done, for the ground truth."""
        self.magnitude = max(self.magnitude, magnitude)
        self.notes.append(text)


@dataclass(frozen=True, slots=True)
class Term:
    """An expression in its place, with draws of its own."""

    expression: Expression
    number: int

    @property
    def type(self) -> Type:
        """Of the value."""
        return self.expression.type

    @property
    def cost(self) -> int:
        """Elements that one evaluation computes."""
        return self.expression.cost

    def __call__(self, step: Step) -> Any:
        """Return the value for a message."""
        if DRAWS in self.expression.names:
            step.env[DRAWS] = functools.partial(step.generator, self.number)
        return self.expression(step.env)


class Operator(Protocol):
    """What is done to a message."""

    @property
    def cost(self) -> int:
        """Elements that it computes for one message, at most."""

    def __call__(self, step: Step) -> None:
        """Do it."""


@dataclass(frozen=True, slots=True)
class Compiler:
    """What operators are compiled against.

    Parameters
    ----------
    scenario
        For the places of errors.
    scope
        What expressions may name.
    root
        What paths of fields begin at.
    output
        The type that is emitted.
    state
        What is kept from message to message.
    longest
        Elements that an array may have.
    numbers
        Of the operations, in the order of the document.
    """

    scenario: Scenario
    scope: Scope
    root: Message
    output: Message
    state: Record
    longest: int
    numbers: Iterator[int]

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
        if expected is not None and not isinstance(expression.type, expected):
            what = expected.__name__.lower()
            raise self.scenario.error(key, f"expected a {what}, found a {expression.type}")
        return Term(expression, next(self.numbers))

    def error(self, key: Key, error: ExpressionError) -> ScenarioError:
        """Return what is wrong with an expression, with its place in the file."""
        return self.scenario.error(key, str(error).removesuffix("."))

    def let(
        self, spec: Spec, key: Key, *, elements: int = 1
    ) -> tuple["Compiler", tuple[tuple[str, Term], ...]]:
        """Compile ``let``: each of its names is known to those below it and to the rest."""
        compiler, terms = self, []
        for name, text in spec.get("let", {}).items():
            place = (*key, "let", name)
            term = compiler.term(text, place, elements=elements)
            is_vector = term.expression.vector
            compiler = compiler.with_local(place, name, term.type, is_vector=is_vector)
            terms.append((name, term))
        return compiler, tuple(terms)

    def loop(self, spec: Spec, key: Key, element: Type) -> tuple["Compiler", tuple[str, ...]]:
        """Compile ``as``: names of an element and of its index."""
        names = tuple(spec["as"])
        compiler = self
        for name, kind in zip(names, (element, INTEGER), strict=False):
            is_vector = isinstance(element, Number | Boolean)
            compiler = compiler.with_local((*key, "as"), name, kind, is_vector=is_vector)
        return compiler, names

    def with_local(self, key: Key, name: str, kind: Type, *, is_vector: bool) -> "Compiler":
        """Return a compiler whose expressions may name something more."""
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

    def checkfits(self, value: Term, field: Field, key: Key) -> None:
        """Refuse a value that cannot be stored in a field."""
        if not fits(value.type, field.type):
            raise self.scenario.error(
                key, f"expected a {field.type} for {field.path}, found a {value.type}"
            )

    def width(self, kind: Type) -> int:
        """Return how many elements a value may have."""
        return min(kind.bound or self.longest, self.longest) if isinstance(kind, Array) else 1


@dataclass(frozen=True, slots=True)
class Target:
    """The field that an operator changes."""

    field: Field
    longest: int
    convert: Convert
    keep: bool  # leave what is not finite as it is

    @classmethod
    def of(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Return the target of a specification."""
        field = compiler.field(spec, key)
        convert = converter(field.type, spec.get("on_overflow", "wrap"))
        return cls(field, compiler.longest, convert, spec.get("nonfinite", "keep") == "keep")

    @classmethod
    def of_numbers(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Return the target of a specification that only numbers can meet."""
        target = cls.of(spec, key, compiler)
        if not isinstance(target.element, Number):
            raise compiler.scenario.error(
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
        """Return what stood there when the action began."""
        value = self.field.read(step.original)
        if isinstance(self.field.type, Array) and len(value) > self.longest:
            raise RefusedMessage(
                f"{self.field.path} has {len(value)} elements, limits.array is {self.longest}"
            )
        return value

    def numbers(self, step: Step) -> tuple[Any, Any]:
        """Return what stood there, as it was and, if numbers, such as can be reckoned with."""
        old = self.old(step)
        if isinstance(old, np.ndarray) and old.dtype.kind != "b":
            return old, old.astype(np.int64 if old.dtype.kind in "iu" else np.float64)
        return old, old

    def change(self, step: Step, old: Any, new: Any) -> None:
        """Put something else there: a value, or a whole array for an array."""
        new = self.convert(new, old)
        step.message = self.field.replaced(step.message, new)
        step.note(*difference(self.field.path, old, new))

    def change_numbers(self, step: Step, old: Any, new: Any) -> None:
        """Put other numbers there, where the old ones are to be changed."""
        if self.keep and isinstance(old, np.ndarray):
            new = np.where(np.isfinite(old), new, old)
        elif self.keep and not math.isfinite(old):
            new = old
        self.change(step, old, new)


def fits(value: Type, target: Type) -> bool:
    """Tell whether a value of one type can be stored as another."""
    match value, target:
        case (Number(), Number()) | (Boolean(), Boolean()) | (Text(), Text()):
            return True
        case Array(), Array():
            roomy = target.bound is None or (value.bound or math.inf) <= target.bound
            exact = value.fixed and value.bound == target.bound
            return fits(value.element, target.element) and (exact if target.fixed else roomy)
        case Number() | Boolean(), Array():
            return fits(value, target.element)
    return isinstance(value, Message) and value == target
