"""The operators of the scenario language by name, and the compilation of an action's operators.

An operator is compiled once against the message type and then applied to each message's ``Step``.
"""

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

from sim.fuzzing import output_operators as outputs
from sim.fuzzing import value_operators as values
from sim.fuzzing.compile_context import CompileContext, Spec, Target
from sim.fuzzing.scenario import Key
from sim.fuzzing.state_operators import compile_store
from sim.fuzzing.step import Operator, Step
from sim.fuzzing.value_types import Message


def _compile_for_each(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Apply operators to every message in an array of messages."""
    target = Target.of(spec, key, context)
    element_type = target.element
    if element_type == target.field.type or not isinstance(element_type, Message):
        raise context.scenario.error(
            (*key, "field"),
            f"expected an array of messages, {target.field.path} is a {target.field.type}; "
            "arrays of numbers take map_array",
        )
    inner, names = context.loop(spec, key, element_type)
    when = inner.condition(spec, key)
    inner, let = inner.let(spec, key)
    inner = dataclasses.replace(inner, root=element_type)
    do = compile_operators(spec["do"], (*key, "do"), inner, ON_ELEMENTS)

    def changed(step: Step, i: int, element: Any) -> Any:
        env = values.with_names(step.env, names, element, i)
        inner = dataclasses.replace(
            step, env=env, original=element, message=element, notes=[], branch=i + 1
        )
        if when is None or when(inner):
            for name, term in let:
                inner.env[name] = term(inner)
            for part in do:
                part.apply(inner)
            step.magnitude = max(step.magnitude, inner.magnitude)
        return inner.message

    def apply(step: Step) -> None:
        old = target.old(step)
        target.change(step, old, [changed(step, *place) for place in enumerate(old)])

    terms = [term for _, term in let] + ([when] if when else [])
    work = 1 + sum(term.cost for term in terms) + sum(operator.cost for operator in do)
    return Operator(apply, values.LOOP_WORK * work * context.width(target.field.type))


OPERATORS: Mapping[str, Callable[[Spec, Key, CompileContext], Operator]] = {
    "set": values.compile_set,
    "add": partial(values.compile_arithmetic, amount="by", combine=lambda x, by, _: x + by),
    "scale": partial(values.compile_arithmetic, amount="by", combine=lambda x, by, _: x * by),
    "noise": values.compile_noise,
    "drift": partial(
        values.compile_arithmetic, amount="rate", combine=lambda x, rate, t: x + rate * t
    ),
    "map_array": values.compile_map_array,
    "for_each": _compile_for_each,
    "remove_where": values.compile_remove_where,
    "mutate": values.compile_mutate,
    "drop": outputs.compile_drop,
    "delay": outputs.compile_delay,
    "duplicate": outputs.compile_duplicate,
    "replay": outputs.compile_playback,
    "freeze": outputs.compile_playback,
    "emit": outputs.compile_emit,
    "store": compile_store,
}
ON_ELEMENTS = ("set", "add", "scale", "noise", "drift", "map_array")
ON_TIMER = ("emit", "store")


def compile_operators(
    specs: Sequence[Spec],
    key: Key,
    context: CompileContext,
    allowed: Collection[str] = tuple(OPERATORS),
) -> tuple[Operator, ...]:
    """Compile the operators of one action.

    An operator that is not allowed there, is invalid, or changes the same field as another one is
    left out and added to the context's faults.
    """
    operators, changed = [], list[str]()
    for place, spec in enumerate(specs):
        ((name, details),) = spec.items()
        at = (*key, place, name)
        with context.faults.gathered():
            if name not in allowed:
                raise context.scenario.error(
                    at, f"expected one of {', '.join(allowed)} here, found {name}"
                )
            path = details.get("field")
            _check_unchanged(path, changed, (*at, "field"), context)
            changed += [path] if path else []
            operators.append(OPERATORS[name](details, at, context))
    return tuple(operators)


def _check_unchanged(
    path: str | None, changed: Sequence[str], key: Key, context: CompileContext
) -> None:
    """Refuse a field that another operator changes, as a whole or in part."""
    for other in changed:
        if path and (f"{path}.".startswith(f"{other}.") or f"{other}.".startswith(f"{path}.")):
            raise context.scenario.error(
                key,
                f"expected a field that no operator above changes, {other} is changed there: "
                "all read the original, so put it into a separate action with match: all",
            )
