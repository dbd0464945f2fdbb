"""The operators of the scenario language, one class each.

An operator is compiled once against the message type and then called with each message's ``Step``.
Values are read from the message as the action found it, whatever the operators before have
changed; changes go into a copy, so what came in stays as it was. What an operator did it notes in
the step, for the ground truth.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from sim.fuzzing.compiler import Compiler, Operator, Spec, Step, Target, Term, fits
from sim.fuzzing.fields import Convert, Field, converter, difference, with_fields, zero
from sim.fuzzing.mutator import MUTATIONS, Mutator
from sim.fuzzing.scenario import Key
from sim.fuzzing.values import (
    Array,
    Boolean,
    Message,
    Number,
    Table,
    Text,
    strip_padding,
)

MAX_OUTPUTS = 1000  # for one message
STORED_NS = "_stored_ns"  # when a row of a table was stored; expressions cannot name it

_MAX_DELAY_S = 60.0
_LOOP_WORK = 256  # what a round of a Python loop costs, in elements of an array
_NOISE_WORK = 8  # what drawing and adding noise costs for an element


@dataclass(frozen=True, slots=True)
class Set:
    """Put a value into a field; one number goes into every element of an array."""

    target: Target
    value: Term
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        target, place = Target.of(spec, key, compiler), (*key, "value")
        value = compiler.term(spec["value"], place)
        compiler.checkfits(value, target.field, place)
        return cls(target, value, value.cost + compiler.width(target.field.type))

    def __call__(self, step: Step) -> None:
        """Do it."""
        self.target.change(step, self.target.old(step), self.value(step))


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """Add to a number or to every element of an array, or multiply it."""

    target: Target
    by: Term
    combine: Callable[[Any, Any], Any]
    cost: int

    @classmethod
    def compile(
        cls, spec: Spec, key: Key, compiler: Compiler, *, combine: Callable[[Any, Any], Any]
    ) -> Self:
        """Check and compile."""
        target = Target.of_numbers(spec, key, compiler)
        by = compiler.term(spec["by"], (*key, "by"), Number)
        return cls(target, by, combine, by.cost + compiler.width(target.field.type))

    def __call__(self, step: Step) -> None:
        """Do it."""
        old, numbers = self.target.numbers(step)
        self.target.change_numbers(step, old, self.combine(numbers, self.by(step)))


@dataclass(frozen=True, slots=True)
class Drift:
    """Add what grows with the time since activation, at a rate a second."""

    target: Target
    rate: Term
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        target = Target.of_numbers(spec, key, compiler)
        rate = compiler.term(spec["rate"], (*key, "rate"), Number)
        return cls(target, rate, rate.cost + compiler.width(target.field.type))

    def __call__(self, step: Step) -> None:
        """Do it."""
        old, numbers = self.target.numbers(step)
        self.target.change_numbers(step, old, numbers + self.rate(step) * step.env["t"])


@dataclass(frozen=True, slots=True)
class Noise:
    """Add an independent draw to every number.

    Uniform noise is drawn from [-spread, spread), Gaussian has the spread for its standard
    deviation. The spread is given, or relative to each number.
    """

    target: Target
    spread: Term
    is_relative: bool
    is_uniform: bool
    limits: tuple[Term, Term] | None  # of what comes out
    number: int
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        target = Target.of_numbers(spec, key, compiler)
        kinds = [kind for kind in ("relative", "absolute") if kind in spec]
        if len(kinds) != 1:
            raise compiler.scenario.error(key, "expected one of the keys relative, absolute")
        spread = compiler.term(spec[kinds[0]], (*key, kinds[0]), Number)
        limits = None
        if "clip" in spec:
            low, high = (
                compiler.term(text, (*key, "clip", end), Number)
                for end, text in enumerate(spec["clip"])
            )
            limits = low, high
        cost = spread.cost + _NOISE_WORK * compiler.width(target.field.type)
        number = next(compiler.numbers)
        return cls(
            target, spread, kinds == ["relative"], spec["dist"] == "uniform", limits, number, cost
        )

    def __call__(self, step: Step) -> None:
        """Do it."""
        old, numbers = self.target.numbers(step)
        count = len(old) if isinstance(old, np.ndarray) else None
        rng = step.generator(self.number)
        spread = self.spread(step)
        if self.is_relative:
            spread = spread * numbers
        if self.is_uniform:  # in the order in which random.uniform(-spread, spread) reckons
            noise = -spread + (spread + spread) * rng.random(count)
        else:
            noise = spread * rng.standard_normal(count)
        new = numbers + noise
        if self.limits is not None:
            low, high = (limit(step) for limit in self.limits)
            new = np.minimum(np.maximum(new, low), high)
        self.target.change_numbers(step, old, new if count is not None else float(new))


@dataclass(frozen=True, slots=True)
class MapArray:
    """Work every element of an array out anew, from itself and its index."""

    target: Target
    names: tuple[str, ...]
    let: tuple[tuple[str, Term], ...]
    value: Term
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        target = Target.of(spec, key, compiler)
        if target.element == target.field.type or not isinstance(target.element, Number | Boolean):
            raise compiler.scenario.error(
                (*key, "field"),
                f"expected an array of numbers or booleans, {target.field.path} is a "
                f"{target.field.type}",
            )
        elements = compiler.width(target.field.type)
        inner, names = compiler.loop(spec, key, target.element)
        inner, let = inner.let(spec, key, elements=elements)
        kind = Number if isinstance(target.element, Number) else Boolean
        value = inner.term(spec["value"], (*key, "value"), kind, elements=elements)
        cost = elements + value.cost + sum(term.cost for _, term in let)
        return cls(target, names, let, value, cost)

    def __call__(self, step: Step) -> None:
        """Do it."""
        old, numbers = self.target.numbers(step)
        outer = step.env
        step.env = {**outer, **dict(zip(self.names, (numbers, np.arange(len(old))), strict=False))}
        for name, term in self.let:
            step.env[name] = term(step)
        new = self.value(step)
        step.env = outer
        self.target.change_numbers(step, old, new)


@dataclass(frozen=True, slots=True)
class ForEach:
    """Do something to every message in an array of messages."""

    target: Target
    names: tuple[str, ...]
    when: Term | None
    let: tuple[tuple[str, Term], ...]
    do: tuple[Operator, ...]
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        target = Target.of(spec, key, compiler)
        element = target.element
        if element == target.field.type or not isinstance(element, Message):
            raise compiler.scenario.error(
                (*key, "field"),
                f"expected an array of messages, {target.field.path} is a {target.field.type}; "
                "arrays of numbers take map_array",
            )
        inner, names = compiler.loop(spec, key, element)
        when = None
        if "when" in spec:
            when = inner.term(spec["when"], (*key, "when"), Boolean)
        inner, let = inner.let(spec, key)
        inner = dataclasses.replace(inner, root=element)
        do = compile_operators(spec["do"], (*key, "do"), inner, ON_ELEMENTS)
        terms = [term for _, term in let] + ([when] if when else [])
        work = 1 + sum(part.cost for part in (*terms, *do))
        return cls(
            target, names, when, let, do, _LOOP_WORK * work * compiler.width(target.field.type)
        )

    def __call__(self, step: Step) -> None:
        """Do it."""
        old = self.target.old(step)
        new = [self._element(step, *place) for place in enumerate(old)]
        self.target.change(step, old, new)

    def _element(self, step: Step, i: int, element: Any) -> Any:
        env = {**step.env, **dict(zip(self.names, (element, i), strict=False))}
        inner = dataclasses.replace(
            step, env=env, original=element, message=element, notes=[], branch=i + 1
        )
        if self.when is None or self.when(inner):
            for name, term in self.let:
                inner.env[name] = term(inner)
            for part in self.do:
                part(inner)
            step.magnitude = max(step.magnitude, inner.magnitude)
        return inner.message


@dataclass(frozen=True, slots=True)
class RemoveWhere:
    """Take out the elements of an array for which something holds."""

    target: Target
    names: tuple[str, ...]
    where: Term
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        target = Target.of(spec, key, compiler)
        kind = target.field.type
        if not isinstance(kind, Array) or kind.fixed:
            raise compiler.scenario.error(
                (*key, "field"),
                f"expected an array of any length, {target.field.path} is a {kind}"
                f"{' of fixed length' if isinstance(kind, Array) else ''}",
            )
        elements = compiler.width(kind)
        inner, names = compiler.loop(spec, key, kind.element)
        where = inner.term(spec["where"], (*key, "where"), Boolean, elements=elements)
        is_vector = isinstance(kind.element, Number | Boolean)
        cost = elements + where.cost if is_vector else _LOOP_WORK * elements * where.cost
        return cls(target, names, where, cost)

    def __call__(self, step: Step) -> None:
        """Do it."""
        old, outer = self.target.old(step), step.env
        if isinstance(old, np.ndarray):
            step.env = {**outer, **dict(zip(self.names, (old, np.arange(len(old))), strict=False))}
            new = old[~np.broadcast_to(self.where(step), old.shape)]
        else:
            new = []
            for i, element in enumerate(old):
                step.env = {**outer, **dict(zip(self.names, (element, i), strict=False))}
                step.branch = i + 1
                if not self.where(step):
                    new.append(element)
            step.branch = 0
        step.env = outer
        step.message = self.target.field.replaced(step.message, new)
        step.note(*difference(self.target.field.path, old, new))


@dataclass(frozen=True, slots=True)
class Mutate:
    """Change values of fields drawn at random, as their types suggest."""

    mutator: Mutator
    count: int
    number: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        fields = spec.get("fields", [])
        for place, path in enumerate(fields):
            compiler.field_at(path, (*key, "fields", place), compiler.root)
        mutator = Mutator.of(compiler.root, fields, spec.get("mutations", list(MUTATIONS)))
        return cls(mutator, spec.get("count", 1), next(compiler.numbers))

    @property
    def cost(self) -> int:
        """Elements that it computes, at most."""
        return self.count * (_LOOP_WORK + len(self.mutator.leaves))

    def __call__(self, step: Step) -> None:
        """Do it."""
        for place in range(self.count):
            rng = step.generator(self.number, place)
            step.message, magnitude, text = self.mutator(step.message, rng)
            step.note(magnitude, text)


@dataclass(frozen=True, slots=True)
class Drop:
    """Hand nothing on."""

    cost: int = 1

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:  # noqa: ARG003
        """Check and compile."""
        return cls()

    def __call__(self, step: Step) -> None:
        """Do it."""
        step.dropped = True
        step.note(1.0, "dropped")


@dataclass(frozen=True, slots=True)
class Delay:
    """Hand on later, by a minute at most."""

    seconds: Term

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        return cls(compiler.term(spec["seconds"], (*key, "seconds"), Number))

    @property
    def cost(self) -> int:
        """Elements that it computes, at most."""
        return self.seconds.cost

    def __call__(self, step: Step) -> None:
        """Do it."""
        step.delay_s = _clamped(self.seconds(step), 0.0, _MAX_DELAY_S)
        step.note(step.delay_s, f"delayed by {step.delay_s:.6g} s")


@dataclass(frozen=True, slots=True)
class Duplicate:
    """Hand on several times, ``spacing_s`` apart."""

    copies: Term
    spacing_s: Term

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        return cls(
            compiler.term(spec["copies"], (*key, "copies"), Number),
            compiler.term(spec.get("spacing_s", 0.0), (*key, "spacing_s"), Number),
        )

    @property
    def cost(self) -> int:
        """Elements that it computes, at most."""
        return self.copies.cost + self.spacing_s.cost

    def __call__(self, step: Step) -> None:
        """Do it."""
        step.copies = int(_clamped(self.copies(step), 1.0, MAX_OUTPUTS))
        step.spacing_s = _clamped(self.spacing_s(step), 0.0, _MAX_DELAY_S)
        step.note(float(step.copies), f"{step.copies} copies")


class _Held(NamedTuple):
    """What is played back, and since when."""

    messages: Sequence[Any]
    oldest: int  # how many messages came before the first of them
    first: int  # and before the one at which it began
    last: int  # and before the latest


@dataclass(frozen=True, slots=True)
class Playback:
    """Hand on messages of before, over and over, under the headers of those that come.

    They are the last ``messages`` from before it began, or without any the one at which it began.
    It begins anew after a message to which it did not apply.
    """

    messages: int
    number: int
    cost: int = 1

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:  # noqa: ARG003
        """Check and compile."""
        return cls(spec.get("messages", 0), next(compiler.numbers))

    def __call__(self, step: Step) -> None:
        """Do it."""
        held = step.memory.get(self.number)
        if held is None or held.last != step.heard - 1:
            before = list(step.recent)[-1 - self.messages : -1]
            oldest = step.heard - len(before)
            held = _Held(before or [step.message], oldest, step.heard, step.heard)
        step.memory[self.number] = held._replace(last=step.heard)
        place = (step.heard - held.first) % len(held.messages)
        ago = step.heard - held.oldest - place
        step.message = restamped(held.messages[place], step.header)
        step.note(float(ago), f"as {ago} messages before")


@dataclass(frozen=True, slots=True)
class Emit:
    """Publish one message more: a copy of the one that came, or a new one."""

    is_copy: bool
    output: Message
    fields: tuple[tuple[Field, Convert, Term], ...]
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        is_copy = "copy" in spec
        if is_copy and "msg" not in compiler.scope.names:
            raise compiler.scenario.error(
                (*key, "copy"), "expected no copy: a timer has no message"
            )
        fields = []
        for path, text in spec["fields"].items():
            place = (*key, "fields", path)
            field = compiler.field_at(path, place, compiler.output)
            value = compiler.term(text, place)
            compiler.checkfits(value, field, place)
            fields.append((field, converter(field.type), value))
        cost = 1 + sum(value.cost + compiler.width(field.type) for field, _, value in fields)
        return cls(is_copy, compiler.output, tuple(fields), cost)

    def __call__(self, step: Step) -> None:
        """Do it."""
        message = step.original if self.is_copy else restamped(zero(self.output), step.header)
        for place, convert, value in self.fields:
            message = place.replaced(message, convert(value(step), place.read(message)))
        step.emitted.append(message)
        step.note(1.0, "1 emitted")


@dataclass(frozen=True, slots=True)
class Store:
    """Keep a value until other messages come."""

    into: str
    convert: Convert
    value: Term

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler) -> Self:
        """Check and compile."""
        kind = compiler.state.fields[spec["into"]]
        value = compiler.term(spec["value"], (*key, "value"))
        if not fits(value.type, kind):
            raise compiler.scenario.error(
                (*key, "value"), f"expected a {kind}, found a {value.type}"
            )
        return cls(spec["into"], converter(kind), value)

    @property
    def cost(self) -> int:
        """Elements that it computes, at most."""
        return self.value.cost

    def __call__(self, step: Step) -> None:
        """Do it."""
        state = step.env["state"]
        state[self.into] = self.convert(self.value(step), state[self.into])


@dataclass(frozen=True, slots=True)
class StoreRow:
    """Keep a row of a table; where the table is full, the row that was stored first makes room."""

    into: str
    max_size: int
    key: Term
    columns: tuple[tuple[str, Convert, Term], ...]

    @classmethod
    def compile(cls, spec: Spec, key: Key, compiler: Compiler, table: Table) -> Self:
        """Check and compile."""
        if "key" not in spec:
            raise compiler.scenario.error(key, f"expected the key key: {spec['into']} is a map")
        row, place = spec["value"], (*key, "value")
        if not isinstance(row, Mapping) or set(row) != set(table.row.fields):
            names = ", ".join(table.row.fields)
            raise compiler.scenario.error(place, f"expected a value for each of {names}")
        cells = []
        for name, text in row.items():
            kind = table.row.fields[name]
            value = compiler.term(text, (*place, name))
            if not fits(value.type, kind):
                raise compiler.scenario.error(
                    (*place, name), f"expected a {kind}, found a {value.type}"
                )
            cells.append((name, converter(kind), value))
        return cls(
            spec["into"],
            table.max_size,
            compiler.term(spec["key"], (*key, "key"), Text),
            tuple(cells),
        )

    @property
    def cost(self) -> int:
        """Elements that it computes, at most."""
        return self.key.cost + sum(value.cost for _, _, value in self.columns)

    def __call__(self, step: Step) -> None:
        """Do it."""
        rows = step.env["state"][self.into]
        row = {name: convert(value(step), 0) for name, convert, value in self.columns}
        key = strip_padding(self.key(step))
        rows.pop(key, None)
        if len(rows) == self.max_size:
            del rows[next(iter(rows))]
        rows[key] = {**row, STORED_NS: step.stamp_ns}


def _store(spec: Spec, key: Key, compiler: Compiler) -> Operator:
    kind = compiler.state.fields.get(spec["into"])
    if kind is None:
        known = ", ".join(compiler.state.fields) or "none"
        raise compiler.scenario.error(
            (*key, "into"), f"expected a name under state, found {spec['into']}; there are: {known}"
        )
    if isinstance(kind, Table):
        return StoreRow.compile(spec, key, compiler, kind)
    return Store.compile(spec, key, compiler)


OPERATORS: Mapping[str, Callable[[Spec, Key, Compiler], Operator]] = {
    "set": Set.compile,
    "add": functools.partial(Arithmetic.compile, combine=operator.add),
    "scale": functools.partial(Arithmetic.compile, combine=operator.mul),
    "noise": Noise.compile,
    "drift": Drift.compile,
    "map_array": MapArray.compile,
    "for_each": ForEach.compile,
    "remove_where": RemoveWhere.compile,
    "mutate": Mutate.compile,
    "drop": Drop.compile,
    "delay": Delay.compile,
    "duplicate": Duplicate.compile,
    "replay": Playback.compile,
    "freeze": Playback.compile,
    "emit": Emit.compile,
    "store": _store,
}
ON_ELEMENTS = ("set", "add", "scale", "noise", "drift", "map_array")
ON_TIMER = ("emit", "store")


def compile_operators(
    specs: Sequence[Spec],
    key: Key,
    compiler: Compiler,
    allowed: Collection[str] = tuple(OPERATORS),
) -> tuple[Operator, ...]:
    """Compile the operators of one action.

    Raises
    ------
    ScenarioError
        If one is not allowed there, is wrong, or changes what another one changes as well.
    """
    operators, changed = [], list[str]()
    for place, spec in enumerate(specs):
        ((name, details),) = spec.items()
        at = (*key, place, name)
        if name not in allowed:
            raise compiler.scenario.error(
                at, f"expected one of {', '.join(allowed)} here, found {name}"
            )
        path = details.get("field")
        for other in changed:
            if path and (f"{path}.".startswith(f"{other}.") or f"{other}.".startswith(f"{path}.")):
                raise compiler.scenario.error(
                    (*at, "field"),
                    f"expected a field that no operator above changes, {other} is changed there: "
                    "all read the original, so give it an action of its own with match: all",
                )
        changed += [path] if path else []
        operators.append(OPERATORS[name](details, at, compiler))
    return tuple(operators)


def restamped(message: Any, header: Any) -> Any:
    """Return the message under another header, if its type has one."""
    return message if header is None else with_fields(message, {"header": header})


def _clamped(value: float, low: float, high: float) -> float:
    """Return a number within limits; the lower one for NaN."""
    return min(max(low, value), high)
