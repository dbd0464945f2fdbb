"""Operators that decide which messages are published, when and how often."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from sim.fuzzing.compile_context import CompileContext, Spec
from sim.fuzzing.fields import converter, with_fields
from sim.fuzzing.scenario import Key
from sim.fuzzing.step import Operator, Step
from sim.fuzzing.value_types import Number, has_header, zero
from sim.middleware.stamps import header as make_header

MAX_OUTPUTS = 1000  # for one message

_MAX_DELAY_S = 60.0


def compile_drop(spec: Spec, key: Key, context: CompileContext) -> Operator:  # noqa: ARG001
    """Drop the message."""

    def apply(step: Step) -> None:
        step.dropped = True
        step.note(1.0, "dropped")

    return Operator(apply, 1)


def compile_delay(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Forward later, by at most a minute."""
    seconds = context.term(spec["seconds"], (*key, "seconds"), Number)

    def apply(step: Step) -> None:
        step.delay_s = _clamped(seconds(step), 0.0, _MAX_DELAY_S)
        step.note(step.delay_s, f"delayed by {step.delay_s:.6g} s")

    return Operator(apply, seconds.cost)


def compile_duplicate(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Forward several times, ``spacing_s`` apart."""
    copies = context.term(spec["copies"], (*key, "copies"), Number)
    spacing_s = context.term(spec.get("spacing_s", 0.0), (*key, "spacing_s"), Number)

    def apply(step: Step) -> None:
        step.copies = int(_clamped(copies(step), 1.0, MAX_OUTPUTS))
        step.spacing_s = _clamped(spacing_s(step), 0.0, _MAX_DELAY_S)
        step.note(float(step.copies), f"{step.copies} copies")

    return Operator(apply, copies.cost + spacing_s.cost)


class _Held(NamedTuple):
    """The messages that are replayed, and the start of the replay."""

    messages: Sequence[Any]
    oldest: int  # number of messages before the first of them
    first: int  # number of messages before the start
    last: int  # number of messages before the latest


def compile_playback(spec: Spec, key: Key, context: CompileContext) -> Operator:  # noqa: ARG001
    """Forward earlier messages, repeatedly, under the headers of those that arrive.

    These are the last ``messages`` before the operator began, or else the one at which it began. It
    begins again after a message to which it did not apply.
    """
    messages, number = spec.get("messages", 0), next(context.numbers)

    def apply(step: Step) -> None:
        held = step.memory.get(number)
        if held is None or held.last != step.received - 1:
            before = list(step.recent)[-1 - messages : -1]
            oldest = step.received - len(before)
            held = _Held(before or [step.message], oldest, step.received, step.received)
        step.memory[number] = held._replace(last=step.received)
        place = (step.received - held.first) % len(held.messages)
        ago = step.received - held.oldest - place
        step.message = _restamped(held.messages[place], step.header)
        step.note(float(ago), f"as {ago} messages before")

    return Operator(apply, 1, messages)


def compile_emit(spec: Spec, key: Key, context: CompileContext) -> Operator:
    """Publish one more message: a copy of the one that arrived, or a new one."""
    is_copy, to = "copy" in spec, spec.get("to", "")
    if to not in context.outputs:
        known = ", ".join(name for name in context.outputs if name) or "none"
        raise context.scenario.error((*key, "to"), f"expected one of {known}, found {to}")
    topic, output = context.outputs[to]
    if is_copy and output != context.outputs[""][1]:
        raise context.scenario.error((*key, "copy"), f"expected no copy: {to} is of another type")
    if is_copy and "msg" not in context.scope.names:
        raise context.scenario.error((*key, "copy"), "expected no copy: a timer has no message")
    fields = []
    for path, text in spec["fields"].items():
        place = (*key, "fields", path)
        field = context.field_at(path, place, output)
        value = context.term(text, place)
        context.check_fits(value, field.type, place, field.path)
        fields.append((field, converter(field.type), value))

    def apply(step: Step) -> None:
        message = step.original
        if not is_copy:
            message = zero(output)
            if has_header(output):
                message = _restamped(message, step.header or make_header(step.stamp_ns, ""))
        for place, convert, value in fields:
            message = place.replaced(message, convert(value(step), place.read(message)))
        step.emitted.append((topic, message))
        step.note(1.0, "1 emitted")

    cost = 1 + sum(value.cost + context.width(field.type) for field, _, value in fields)
    return Operator(apply, cost)


def _restamped(message: Any, header: Any) -> Any:
    """Return the message under another header, if its type has one."""
    return message if header is None else with_fields(message, {"header": header})


def _clamped(value: float, low: float, high: float) -> float:
    """Return a number within limits; the lower one for NaN."""
    return min(max(low, value), high)
