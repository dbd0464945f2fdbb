"""Operators that change the values in a message, one class each.

Values are read from the message before the action, without the changes of earlier operators;
changes go into a copy, so the original message does not change. Operators record their
changes in the step, for the ground truth.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from sim.fuzzing.compile_context import CompileContext, Spec, Target
from sim.fuzzing.field_mutations import MUTATIONS, FieldMutator
from sim.fuzzing.fields import difference
from sim.fuzzing.scenario import Key
from sim.fuzzing.step import Step, Term
from sim.fuzzing.value_types import Array, Boolean, Number

LOOP_WORK = 256  # cost of one pass of a Python loop, in elements of an array
_NOISE_WORK = 8  # cost of drawing and adding noise to one element


@dataclass(frozen=True, slots=True)
class Set:
    """Put a value into a field; one number goes into every element of an array."""

    target: Target
    value: Term
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, context: CompileContext) -> Self:
        """Check and compile."""
        target, place = Target.of(spec, key, context), (*key, "value")
        value = context.term(spec["value"], place)
        context.check_fits(value, target.field.type, place, target.field.path)
        return cls(target, value, value.cost + context.width(target.field.type))

    def __call__(self, step: Step) -> None:
        """Apply the operator."""
        self.target.change(step, self.target.old(step), self.value(step))


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """Add to a number or to every element of an array, multiply it, or let it drift."""

    target: Target
    amount: Term
    combine: Callable[[Any, Any, float], Any]  # of numbers, amount and seconds since activation
    cost: int

    @classmethod
    def compile(
        cls,
        spec: Spec,
        key: Key,
        context: CompileContext,
        *,
        amount: str,
        combine: Callable[[Any, Any, float], Any],
    ) -> Self:
        """Check and compile; ``amount`` is the key of the amount."""
        target = Target.of_numbers(spec, key, context)
        term = context.term(spec[amount], (*key, amount), Number)
        return cls(target, term, combine, term.cost + context.width(target.field.type))

    def __call__(self, step: Step) -> None:
        """Apply the operator."""
        old, numbers = self.target.numbers(step)
        new = self.combine(numbers, self.amount(step), step.env["t"])
        self.target.change_numbers(step, old, new)


@dataclass(frozen=True, slots=True)
class Noise:
    """Add an independent draw to every number.

    Uniform noise is drawn from [-spread, spread), Gaussian noise has the spread as standard
    deviation. The spread is given, or relative to each number.
    """

    target: Target
    spread: Term
    is_relative: bool
    is_uniform: bool
    limits: tuple[Term, Term] | None  # of the result
    number: int
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, context: CompileContext) -> Self:
        """Check and compile."""
        target = Target.of_numbers(spec, key, context)
        kinds = [kind for kind in ("relative", "absolute") if kind in spec]
        if len(kinds) != 1:
            raise context.scenario.error(key, "expected one of the keys relative, absolute")
        spread = context.term(spec[kinds[0]], (*key, kinds[0]), Number)
        limits = None
        if "clip" in spec:
            low, high = (
                context.term(text, (*key, "clip", end), Number)
                for end, text in enumerate(spec["clip"])
            )
            limits = low, high
        cost = spread.cost + _NOISE_WORK * context.width(target.field.type)
        number = next(context.numbers)
        return cls(
            target, spread, kinds == ["relative"], spec["dist"] == "uniform", limits, number, cost
        )

    def __call__(self, step: Step) -> None:
        """Apply the operator."""
        old, numbers = self.target.numbers(step)
        count = len(old) if isinstance(old, np.ndarray) else None
        rng = step.generator(self.number)
        spread = self.spread(step)
        if self.is_relative:
            spread = spread * numbers
        if self.is_uniform:  # in the order of the operations of random.uniform(-spread, spread)
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
    """Compute every element of an array from itself and its index."""

    target: Target
    names: tuple[str, ...]
    let: tuple[tuple[str, Term], ...]
    value: Term
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, context: CompileContext) -> Self:
        """Check and compile."""
        target = Target.of(spec, key, context)
        if target.element == target.field.type or not isinstance(target.element, Number | Boolean):
            raise context.scenario.error(
                (*key, "field"),
                f"expected an array of numbers or booleans, {target.field.path} is a "
                f"{target.field.type}",
            )
        elements = context.width(target.field.type)
        inner, names = context.loop(spec, key, target.element)
        inner, let = inner.let(spec, key, elements=elements)
        kind = Number if isinstance(target.element, Number) else Boolean
        value = inner.term(spec["value"], (*key, "value"), kind, elements=elements)
        cost = elements + value.cost + sum(term.cost for _, term in let)
        return cls(target, names, let, value, cost)

    def __call__(self, step: Step) -> None:
        """Apply the operator."""
        old, numbers = self.target.numbers(step)
        outer = step.env
        step.env = {**outer, **dict(zip(self.names, (numbers, np.arange(len(old))), strict=False))}
        for name, term in self.let:
            step.env[name] = term(step)
        new = self.value(step)
        step.env = outer
        self.target.change_numbers(step, old, new)


@dataclass(frozen=True, slots=True)
class RemoveWhere:
    """Remove the elements of an array for which a condition holds."""

    target: Target
    names: tuple[str, ...]
    where: Term
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, context: CompileContext) -> Self:
        """Check and compile."""
        target = Target.of(spec, key, context)
        kind = target.field.type
        if not isinstance(kind, Array) or kind.fixed:
            raise context.scenario.error(
                (*key, "field"),
                f"expected an array of any length, {target.field.path} is a {kind}"
                f"{' of fixed length' if isinstance(kind, Array) else ''}",
            )
        elements = context.width(kind)
        inner, names = context.loop(spec, key, kind.element)
        where = inner.term(spec["where"], (*key, "where"), Boolean, elements=elements)
        is_vector = isinstance(kind.element, Number | Boolean)
        cost = elements + where.cost if is_vector else LOOP_WORK * elements * where.cost
        return cls(target, names, where, cost)

    def __call__(self, step: Step) -> None:
        """Apply the operator."""
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

    mutator: FieldMutator
    count: int
    number: int
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, context: CompileContext) -> Self:
        """Check and compile."""
        fields = spec.get("fields", [])
        for place, path in enumerate(fields):
            context.field_at(path, (*key, "fields", place), context.root)
        mutator = FieldMutator.of(context.root, fields, spec.get("mutations", list(MUTATIONS)))
        count = spec.get("count", 1)
        cost = count * (LOOP_WORK + len(mutator.leaves))
        return cls(mutator, count, next(context.numbers), cost)

    def __call__(self, step: Step) -> None:
        """Apply the operator."""
        for place in range(self.count):
            rng = step.generator(self.number, place)
            step.message, magnitude, text = self.mutator(step.message, rng)
            step.note(magnitude, text)
