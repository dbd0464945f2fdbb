"""A message that a scenario processes, with the values computed for it."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim.fuzzing.expressions import Expression
from sim.fuzzing.random import Draws
from sim.fuzzing.scopes import DRAWS
from sim.fuzzing.value_types import Type

ACTIVATION = 0  # the operation whose draw decides whether a message is altered

_BRANCH = 1 << 32  # distance between the operation numbers of two rounds of a loop


@dataclass(slots=True)
class Step:
    """One message, or one tick of a timer, that a scenario processes."""

    stamp_ns: int  # when it was published
    received: int  # number of messages before
    index: int  # number that determines its draws
    draws: Draws
    env: dict[str, Any]  # the values of names
    header: Any  # for new messages; None if the type has none
    recent: Sequence[Any]  # the last messages, including this one
    memory: dict[int, Any]  # of operators, from message to message
    original: Any = None  # the message, or element, before the action
    message: Any = None  # with the changes so far
    dropped: bool = False
    delay_s: float = 0.0
    copies: int = 1
    spacing_s: float = 0.0
    emitted: list[tuple[str, Any]] = field(default_factory=list)  # by topic
    magnitude: float = 0.0
    notes: list[str] = field(default_factory=list)
    branch: int = 0

    def generator(self, operation: int, place: int = 0) -> np.random.Generator:
        """Return the generator of one draw."""
        return self.draws.generator(self.index, operation + self.branch * _BRANCH, place)

    def note(self, magnitude: float, text: str) -> None:
        """Record a change for the ground truth."""
        self.magnitude = max(self.magnitude, magnitude)
        self.notes.append(text)


@dataclass(frozen=True, slots=True)
class Term:
    """An expression in its place, with independent draws."""

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


@dataclass(frozen=True, slots=True)
class Operator:
    """A compiled operator."""

    apply: Callable[[Step], None]  # changes the message
    cost: int  # elements that it computes for one message, at most
    messages: int = 0  # number of earlier messages that it needs
