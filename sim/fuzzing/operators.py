"""The operators of the scenario language by name, and the compilation of an action's operators.

An operator is compiled once against the message type and then called with each message's ``Step``.
"""

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

from sim.fuzzing.compile_context import CompileContext, Spec, Target
from sim.fuzzing.output_operators import Delay, Drop, Duplicate, Emit, Playback
from sim.fuzzing.scenario import Key
from sim.fuzzing.state_operators import compile_store
from sim.fuzzing.step import Operator, Step, Term
from sim.fuzzing.value_operators import (
    LOOP_WORK,
    Arithmetic,
    MapArray,
    Mutate,
    Noise,
    RemoveWhere,
    Set,
)
from sim.fuzzing.value_types import Boolean, Message


@dataclass(frozen=True, slots=True)
class _ForEach:
    """Apply operators to every message in an array of messages."""

    target: Target
    names: tuple[str, ...]
    when: Term | None
    let: tuple[tuple[str, Term], ...]
    do: tuple[Operator, ...]
    cost: int

    @classmethod
    def compile(cls, spec: Spec, key: Key, context: CompileContext) -> Self:
        """Check and compile."""
        target = Target.of(spec, key, context)
        element = target.element
        if element == target.field.type or not isinstance(element, Message):
            raise context.scenario.error(
                (*key, "field"),
                f"expected an array of messages, {target.field.path} is a {target.field.type}; "
                "arrays of numbers take map_array",
            )
        inner, names = context.loop(spec, key, element)
        when = None
        if "when" in spec:
            when = inner.term(spec["when"], (*key, "when"), Boolean)
        inner, let = inner.let(spec, key)
        inner = dataclasses.replace(inner, root=element)
        do = compile_operators(spec["do"], (*key, "do"), inner, ON_ELEMENTS)
        terms = [term for _, term in let] + ([when] if when else [])
        work = 1 + sum(part.cost for part in (*terms, *do))
        return cls(
            target, names, when, let, do, LOOP_WORK * work * context.width(target.field.type)
        )

    def __call__(self, step: Step) -> None:
        """Apply the operator."""
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


OPERATORS: Mapping[str, Callable[[Spec, Key, CompileContext], Operator]] = {
    "set": Set.compile,
    "add": partial(Arithmetic.compile, amount="by", combine=lambda x, by, _: x + by),
    "scale": partial(Arithmetic.compile, amount="by", combine=lambda x, by, _: x * by),
    "noise": Noise.compile,
    "drift": partial(Arithmetic.compile, amount="rate", combine=lambda x, rate, t: x + rate * t),
    "map_array": MapArray.compile,
    "for_each": _ForEach.compile,
    "remove_where": RemoveWhere.compile,
    "mutate": Mutate.compile,
    "drop": Drop.compile,
    "delay": Delay.compile,
    "duplicate": Duplicate.compile,
    "replay": Playback.compile,
    "freeze": Playback.compile,
    "emit": Emit.compile,
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
