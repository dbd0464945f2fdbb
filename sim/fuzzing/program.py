"""A compiled scenario: data that does not change while it is executed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sim.fuzzing.scenario import Scenario
from sim.fuzzing.step import Operator, Step, Term
from sim.fuzzing.units import readings
from sim.fuzzing.value_types import Boolean, Message, Number, Record, Text, Type, has_header


@dataclass(frozen=True, slots=True)
class Parameter:
    """A value that each run may choose."""

    name: str
    type: Type
    default: Any
    low: float | None
    high: float | None
    unit: str = ""

    def checked(self, value: Any) -> Any:
        """Return a value converted to its type.

        Raises
        ------
        ValueError
            If it is of another type, too long or out of range; the text says what was expected.
        """
        match self.type:
            case Number():
                kinds = int if self.type.is_integer else int | float
                fits = isinstance(value, kinds) and not isinstance(value, bool)
                what = "a whole number" if self.type.is_integer else "a number"
                what += f" in {self.unit}" if self.unit else ""
            case Boolean():
                fits, what = isinstance(value, bool), "true or false"
            case Text(max_len):
                fits = isinstance(value, str) and len(value) <= max_len
                what = f"a text of at most {max_len} characters"
            case _:
                raise TypeError(self.type)
        if not fits:
            raise ValueError(f"expected {what}, found {value!r}{self._hint(value)}")
        if isinstance(self.type, Number):
            if not self._includes(value):
                low, high = self._bounds
                within = f"{low} to {high} {self.unit}".strip()
                raise ValueError(f"expected {within}, found {value}{self._hint(value)}")
            return value if self.type.is_integer else float(value)
        return value

    @property
    def _bounds(self) -> tuple[float, float]:
        return (
            -np.inf if self.low is None else self.low,
            np.inf if self.high is None else self.high,
        )

    def _includes(self, value: float) -> bool:
        low, high = self._bounds
        return low <= value <= high

    def _hint(self, value: object) -> str:
        """Return what a value is in the parameter's unit, if it was written in another one."""
        if not isinstance(self.type, Number) or self.type.is_integer:
            return ""
        meant = readings(value, self.unit)
        fitting = (
            f"{words} is {n:.4g} {self.unit}".strip() for words, n in meant if self._includes(n)
        )
        return next((f" ({words})" for words in fitting), "")


@dataclass(frozen=True, slots=True)
class Source:
    """A further topic that the scenario reads."""

    topic: str
    type: Message
    as_sent: Callable[[Any], Any]
    let: tuple[tuple[str, Term], ...]  # values kept of a message; empty: the message itself
    value: Record
    max_age_ns: int | None
    on_missing: Literal["forward", "drop"]


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """A parameter of a node that is set at the onset."""

    node: str
    name: str
    value: Term


@dataclass(frozen=True, slots=True)
class Activation:
    """When a scenario acts."""

    after: Literal["start", "goal_accepted"] = "start"
    goal: int = 1  # number of the goal, counted from 1
    seconds: float | tuple[float, float] = 0.0  # from then to the onset; two: drawn between them
    before: Literal["forward", "absent"] = "forward"  # absent: the node appears at the onset
    duration_s: float | None = None  # None: to the end
    messages: int | None = None  # number of messages that it acts on, including ticks of the timer
    until_goal: int | None = None  # number of the goal whose acceptance ends it
    probability: float = 1.0  # probability that a message is altered

    def delay_s(self, run_seed: int) -> float:
        """Return the time to the onset, which runs of the same seed share."""
        if isinstance(self.seconds, tuple):
            return np.random.default_rng(run_seed).uniform(*self.seconds)
        return self.seconds

    def includes(self, t_s: float) -> bool:
        """Return whether the scenario acts at a time after its onset."""
        return t_s >= 0.0 and (self.duration_s is None or t_s < self.duration_s)


@dataclass(frozen=True, slots=True)
class Action:
    """Operators that are applied together, if a condition holds."""

    name: str
    when: Term | None
    let: tuple[tuple[str, Term], ...]
    do: tuple[Operator, ...]

    @property
    def cost(self) -> int:
        """Elements that it computes for one message, at most."""
        terms = [*(term for _, term in self.let), *filter(None, [self.when])]
        return sum(term.cost for term in terms) + sum(operator.cost for operator in self.do)

    def __call__(self, step: Step) -> bool:
        """Apply the operators if the condition holds; return whether it did."""
        step.original = step.message
        if step.message is not None:
            step.env["msg"] = step.message
        if self.when is not None and not self.when(step):
            return False
        env = step.env
        step.env = dict(env)
        for name, term in self.let:
            step.env[name] = term(step)
        for operator in self.do:
            operator.apply(step)
        step.env = env
        return True


@dataclass(frozen=True, slots=True)
class Program:
    """A scenario that can be executed; see ``compile_scenario`` and ``execute``."""

    scenario: Scenario
    type: Message  # of the main topic
    as_sent: Callable[[Any], Any]  # rounds a message as a recorder receives it
    input_topic: str
    output_topic: str
    further_outputs: dict[str, Message]  # topic -> type
    sources: Mapping[str, Source]
    parameters: Mapping[str, Parameter]
    activation: Activation
    cost: int  # elements computed for one message, at most
    constants: Mapping[str, Any]
    state: Mapping[str, Any]  # initial values
    lifetimes_ns: Mapping[str, int]  # of the rows of tables
    always: Action | None
    actions: tuple[Action, ...]
    first_match_only: bool
    period: Term | None  # of the timer [s]
    timer: Action | None
    magnitude: Term | None
    outputs: int  # at most, for one message
    memory: int  # number of messages kept for playback
    to: tuple[str, ...] = ()  # only these nodes receive what is altered; empty: all
    also: tuple["Program", ...] = ()  # one for each further topic that is altered together
    within_ns: int = 0  # of a further topic: largest delay after its main message
    node_parameters: tuple[ParameterChange, ...] = ()  # set from the onset to the end

    @property
    def has_header(self) -> bool:
        """Whether messages carry a stamp."""
        return has_header(self.type)

    @property
    def lanes(self) -> tuple["Program", ...]:
        """The program of each topic that is altered, the main one first."""
        return (self, *self.also)

    @property
    def outlets(self) -> Mapping[str, Message]:
        """All topics that it publishes on, with their types."""
        return {lane.output_topic: lane.type for lane in self.lanes} | self.further_outputs

    @property
    def is_in_place(self) -> bool:
        """Whether messages are altered at their source."""
        return self.input_topic == self.output_topic
