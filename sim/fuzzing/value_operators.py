"""Operators that change the values in a message, one function each.

Values are read from the message before the action, without the changes of earlier operators;
changes go into a copy, so the original message does not change. Operators record their
changes in the step, for the ground truth.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from sim.fuzzing.compile_context import CompileContext, Spec, Target
from sim.fuzzing.field_mutations import MUTATIONS, FieldMutator
from sim.fuzzing.fields import difference
from sim.fuzzing.scenario import Key
from sim.fuzzing.step import Operator, Step
from sim.fuzzing.value_types import Array, Boolean, Number

LOOP_WORK = 256  # cost of one pass of a Python loop, in elements of an array
_NOISE_WORK = 8  # cost of drawing and adding noise to one element


def compile_set(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Put a value into a field; one number goes into every element of an array."""
    target, place = Target.of(spec, key, context), (*key, "value")
    value = context.term(spec["value"], place)
    context.check_fits(value, target.field.type, place, target.field.path)

    def apply(step: Step) -> None:
        target.change(step, target.old(step), value(step))

    return Operator(apply, value.cost + context.width(target.field.type))


def compile_arithmetic(
    spec: Spec,
    key: Key,
    context: CompileContext,
    *,
    amount: str,
    combine: Callable[[Any, Any, float], Any],
) -> Operator:
    """Add to a number or to every element of an array, multiply it, or let it drift.

    Parameters
    ----------
    spec, key, context
        As of every operator.
    amount
        Key of the amount.
    combine
        Function of the numbers, the amount and the seconds since activation.
    """
    target = Target.of_numbers(spec, key, context)
    term = context.term(spec[amount], (*key, amount), Number)

    def apply(step: Step) -> None:
        old, numbers = target.numbers(step)
        target.change_numbers(step, old, combine(numbers, term(step), step.env["t"]))

    return Operator(apply, term.cost + context.width(target.field.type))


def compile_noise(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Add an independent draw to every number.

    Uniform noise is drawn from [-spread, spread), Gaussian noise has the spread as standard
    deviation. The spread is given, or relative to each number.
    """
    target = Target.of_numbers(spec, key, context)
    kinds = [kind for kind in ("relative", "absolute") if kind in spec]
    if len(kinds) != 1:
        raise context.scenario.error(key, "expected one of the keys relative, absolute")
    spread_term = context.term(spec[kinds[0]], (*key, kinds[0]), Number)
    limits = [
        context.term(text, (*key, "clip", end), Number)
        for end, text in enumerate(spec.get("clip", ()))
    ]
    number = next(context.numbers)

    def apply(step: Step) -> None:
        old, numbers = target.numbers(step)
        count = len(old) if isinstance(old, np.ndarray) else None
        rng = step.generator(number)
        spread = spread_term(step)
        if kinds == ["relative"]:
            spread = spread * numbers
        if spec["dist"] == "uniform":  # operations as those of random.uniform(-spread, spread)
            noise = -spread + (spread + spread) * rng.random(count)
        else:
            noise = spread * rng.standard_normal(count)
        new = numbers + noise
        if limits:
            low, high = (limit(step) for limit in limits)
            new = np.minimum(np.maximum(new, low), high)
        target.change_numbers(step, old, new if count is not None else float(new))

    return Operator(apply, spread_term.cost + _NOISE_WORK * context.width(target.field.type))


def compile_map_array(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Compute every element of an array from itself and its index."""
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

    def apply(step: Step) -> None:
        old, numbers = target.numbers(step)
        outer = step.env
        step.env = with_names(outer, names, numbers, np.arange(len(old)))
        for name, term in let:
            step.env[name] = term(step)
        new = value(step)
        step.env = outer
        target.change_numbers(step, old, new)

    return Operator(apply, elements + value.cost + sum(term.cost for _, term in let))


def compile_remove_where(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Remove the elements of an array for which a condition holds."""
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

    def apply(step: Step) -> None:
        old, outer = target.old(step), step.env
        if isinstance(old, np.ndarray):
            step.env = with_names(outer, names, old, np.arange(len(old)))
            new = old[~np.broadcast_to(where(step), old.shape)]
        else:
            new = []
            for i, element in enumerate(old):
                step.env = with_names(outer, names, element, i)
                step.branch = i + 1
                if not where(step):
                    new.append(element)
            step.branch = 0
        step.env = outer
        step.message = target.field.replaced(step.message, new)
        step.note(*difference(target.field.path, old, new))

    return Operator(
        apply, elements + where.cost if is_vector else LOOP_WORK * elements * where.cost
    )


def compile_mutate(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Change values of fields drawn at random, as their types suggest."""
    fields = spec.get("fields", [])
    for place, path in enumerate(fields):
        context.field_at(path, (*key, "fields", place), context.root)
    mutator = FieldMutator.of(context.root, fields, spec.get("mutations", list(MUTATIONS)))
    count, number = spec.get("count", 1), next(context.numbers)

    def apply(step: Step) -> None:
        for place in range(count):
            rng = step.generator(number, place)
            step.message, magnitude, text = mutator(step.message, rng)
            step.note(magnitude, text)

    return Operator(apply, count * (LOOP_WORK + len(mutator.leaves)))


def with_names(env: Mapping[str, Any], names: Sequence[str], *values: Any) -> dict[str, Any]:
    """Return the values of names with those of a loop: an element, and its index if it is named."""
    return {**env, **dict(zip(names, values, strict=False))}
