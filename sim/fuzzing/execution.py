"""Executes a scenario on messages.

A ``Program`` is immutable; an ``Execution`` has state. It gives the same outputs in the simulator
and over a recorded bag: the draws for a message depend on the stamp in its header (or on its number
if it has none), never on earlier messages. Times are those of publishing, which a recorder stores.
"""

import copy
import functools
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from sim.fuzzing.fields import RefusedMessage
from sim.fuzzing.ground_truth import GroundTruth
from sim.fuzzing.program import Program, Source
from sim.fuzzing.random import Draws, drawn_values
from sim.fuzzing.state_operators import STORED_NS
from sim.fuzzing.step import ACTIVATION, Step, Term
from sim.fuzzing.value_types import missing
from sim.middleware.executor import SECOND
from sim.middleware.stamps import header as make_header
from sim.middleware.stamps import stamp_ns as nanoseconds

PASSTHROUGH = "passthrough"  # operation number of messages that are forwarded unchanged

_PERIODS_S = (0.001, 3600.0)  # of a timer

_QUIETLY = np.errstate(all="ignore")  # NaN and infinities are values like others


class Output(NamedTuple):
    """A message to publish."""

    due_ns: int
    message: Any
    topic: str


class Result(NamedTuple):
    """The outputs for a message."""

    outputs: list[Output]
    truth: GroundTruth | None  # None: a timer had nothing to do


def execute(
    program: Program, run_seed: int, parameters: Mapping[str, Any] | None = None
) -> "Execution":
    """Begin to execute a program.

    Parameters
    ----------
    program
        The program to execute.
    run_seed
        With the scenario's own seed, the key of all draws.
    parameters
        Values in place of those drawn for the run, or of the defaults.

    Raises
    ------
    ScenarioError
        If there is no such parameter, or it cannot have that value.
    """
    values = {name: parameter.default for name, parameter in program.parameters.items()}
    values |= drawn_values(program.scenario, run_seed)
    for name, value in (parameters or {}).items():
        if name not in values:
            known = ", ".join(values) or "none"
            raise program.scenario.error(("parameters",), f"expected one of {known}, found {name}")
        try:
            values[name] = program.parameters[name].checked(value)
        except ValueError as error:
            raise program.scenario.error(("parameters", name), str(error)) from error
    return Execution(program, Draws(run_seed, program.scenario.seed), values)


@dataclass(slots=True)
class _Shared:
    """State shared by the topics of a scenario that are altered together."""

    state: dict[str, Any]
    sources: dict[str, Any]
    source_ns: dict[str, int] = field(default_factory=dict)  # when each was published
    underived: dict[str, Callable[[], Any]] = field(default_factory=dict)  # by source
    acted: int = 0  # messages and timer ticks so far
    ends_s: float = math.inf
    index: int = 0  # draw index of the last main message
    main_ns: int | None = None  # when it was published

    @classmethod
    def of(cls, program: Program) -> "_Shared":
        return cls(
            {name: copy.copy(value) for name, value in program.state.items()},
            {name: missing(source.value) for name, source in program.sources.items()},
        )


class Execution:
    """One run of a program, begun by ``execute``, with its state between messages.

    Parameters
    ----------
    program
        The program to execute.
    draws
        Its randomness.
    parameters
        A checked value for each of them.
    main
        The execution of the main topic, if this one is for a further topic.

    Attributes
    ----------
    lanes : tuple of Execution
        One for each topic that is altered, this first.
    timer_period_ns : int or None
        How often ``on_timer`` is due, first one period after the onset.
    """

    def __init__(
        self,
        program: Program,
        draws: Draws,
        parameters: Mapping[str, Any],
        main: "Execution | None" = None,
    ) -> None:
        self.program = program
        self._draws = draws
        self._is_main = main is None
        self._shared: _Shared = main._shared if main else _Shared.of(program)
        self._known = {
            "p": dict(parameters),
            "c": program.constants,
            "state": self._shared.state,
            "src": self._shared.sources,
        }
        self._recent: deque[Any] = deque(maxlen=program.memory + 1)
        self._memory: dict[int, Any] = {}
        self._received = 0
        self._published = 0
        self._frame_id = ""
        self._has_header = program.has_header
        self.timer_period_ns = self._period_ns()
        further = (Execution(lane, draws, parameters, self) for lane in program.also)
        self.lanes = (self, *further)

    def end(self, t_s: float) -> None:
        """Stop acting at a time after the onset."""
        self._shared.ends_s = t_s

    def on_source(self, name: str, message: Any, stamp_ns: int) -> None:
        """Take a message of one of the sources.

        Parameters
        ----------
        name
            Of the source.
        message
            As a message object; it is kept and not written to.
        stamp_ns
            When it was published.
        """
        source = self.program.sources[name]
        message = source.as_sent(message)
        self._shared.source_ns[name] = stamp_ns
        if source.let:
            derived = functools.partial(self._derived, source, message, stamp_ns)
            self._shared.underived[name] = derived
        else:
            self._shared.sources[name] = message

    def _derive(self) -> None:
        """Compute values of the latest messages of sources: most have a later one before use."""
        for name, derived in self._shared.underived.items():
            self._shared.sources[name] = derived()
        self._shared.underived.clear()

    def _derived(self, source: Source, message: Any, stamp_ns: int) -> dict[str, Any]:
        """Return the values that a scenario computes from a message of a source."""
        step = self._step(stamp_ns, stamp_ns, {"msg": message})
        for key, term in source.let:
            step.env[key] = term(step)
        return {key: step.env[key] for key, _ in source.let}

    def on_message(self, message: Any, stamp_ns: int, t_s: float) -> Result:
        """Process a message of the main topic.

        Parameters
        ----------
        message
            As a message object; it is not written to.
        stamp_ns
            When it was published. A node that receives it later publishes the outputs later by the
            same time.
        t_s
            From the onset to ``stamp_ns``; negative before.

        Returns
        -------
        Result
            Messages with the time at which each is due, ``stamp_ns`` unless delayed. An unchanged
            message is the same object.
        """
        if self.program.scenario.control == "passthrough":
            stamp = nanoseconds(message.header.stamp) if self._has_header else 0
            return self._forwarded(message, stamp_ns, stamp or stamp_ns, "unchanged")
        return self._altered(message, stamp_ns, t_s)

    @_QUIETLY
    def _altered(self, message: Any, stamp_ns: int, t_s: float) -> Result:
        """Process a message as ``on_message`` does, if the scenario may alter it."""
        truth_ns = stamp_ns
        header = None
        index = self._received
        if self._has_header:
            header = message.header
            self._frame_id = header.frame_id
            if stamp := nanoseconds(header.stamp):
                truth_ns = index = stamp
        index = self._synchronised(index, stamp_ns)
        sent = self.program.as_sent(message)
        self._recent.append(sent)
        step = self._step(stamp_ns, index, {"msg": sent, "t": t_s})
        step.header = header
        step.message = sent
        self._received += 1
        operation = PASSTHROUGH
        reason = self._reason_to_pass(step, t_s)
        if reason is None:
            try:
                operation = self._transform(step)
            except RefusedMessage as refused:
                reason = str(refused)
        self._shared.acted += operation != PASSTHROUGH
        if reason is not None:
            return self._forwarded(message, stamp_ns, truth_ns, reason)
        if self.program.scenario.control != "shadow":
            if step.message is sent:  # unchanged, with the same identity and bytes
                step.message = message
            outputs = self._outputs(step)
        else:
            outputs = [Output(stamp_ns, message, self.program.output_topic)]
        return Result(outputs, self._truth(step, truth_ns, operation, outputs))

    @_QUIETLY
    def on_timer(self, now_ns: int, t_s: float) -> Result:
        """Process a tick of the timer.

        Parameters
        ----------
        now_ns
            When it is due.
        t_s
            From the onset to ``now_ns``.
        """
        timer, control = self.program.timer, self.program.scenario.control
        is_active = control != "passthrough" and self._is_active(t_s)
        if timer is None or not is_active or self._missing_source(now_ns):
            return Result([], None)
        step = self._step(now_ns, now_ns, {"t": t_s})
        if self._has_header:
            step.header = make_header(now_ns, self._frame_id)
        self._forget(now_ns)
        self._derive()
        step.dropped = True  # there is no message to forward
        timer(step)
        if not step.emitted:
            return Result([], None)
        self._shared.acted += 1
        outputs = [] if control == "shadow" else self._outputs(step)
        return Result(outputs, self._truth(step, now_ns, timer.name, outputs))

    def _step(self, stamp_ns: int, index: int, names: dict[str, Any]) -> Step:
        return Step(
            stamp_ns=stamp_ns, received=self._received, index=index, draws=self._draws,
            env={**self._known, **names, "now": stamp_ns / SECOND}, header=None,
            recent=self._recent, memory=self._memory,
        )  # fmt: skip

    @_QUIETLY
    def constant(self, term: Term) -> float:
        """Return the value of an expression that depends on no message."""
        return float(term(self._step(0, 0, {})))

    def _period_ns(self) -> int | None:
        program = self.program
        if program.period is None:
            return None
        period_s = self.constant(program.period)
        low, high = _PERIODS_S
        if not low <= period_s <= high:
            raise program.scenario.error(
                ("transform", "timer", "period_s"), f"expected {low} to {high} s, found {period_s}"
            )
        return round(period_s * SECOND)

    def _forwarded(self, message: Any, stamp_ns: int, truth_ns: int, reason: str) -> Result:
        """Return a message unchanged, and why."""
        topic, index = self.program.output_topic, self._published
        self._published += 1
        truth = GroundTruth(truth_ns, topic, index, PASSTHROUGH, 0.0, reason)
        return Result([Output(stamp_ns, message, topic)], truth)

    def _reason_to_pass(self, step: Step, t_s: float) -> str | None:
        """Return why a message is forwarded unchanged, or None."""
        if not self._is_active(t_s):
            return "not active"
        share = self.program.activation.probability
        if share < 1.0 and step.generator(ACTIVATION).random() >= share:
            return "spared"
        return None

    def _is_active(self, t_s: float) -> bool:
        activation = self.program.activation
        if not activation.includes(t_s) or t_s >= self._shared.ends_s:
            return False
        return activation.messages is None or self._shared.acted < activation.messages

    def _synchronised(self, index: int, stamp_ns: int) -> int:
        """Return the draw index: on a further topic, that of the previous main message."""
        shared = self._shared
        if self._is_main:
            shared.index, shared.main_ns = index, stamp_ns
        elif shared.main_ns is not None and stamp_ns - shared.main_ns <= self.program.within_ns:
            return shared.index
        return index

    def _missing_source(self, stamp_ns: int) -> tuple[str, str] | None:
        """Return why a source is not usable, and the action for this case."""
        for name, source in self.program.sources.items():
            received_ns = self._shared.source_ns.get(name)
            if received_ns is None:
                return f"no {name} yet", source.on_missing
            if source.max_age_ns is not None and stamp_ns - received_ns > source.max_age_ns:
                return f"{name} is {(stamp_ns - received_ns) / SECOND:.3g} s old", source.on_missing
        return None

    def _transform(self, step: Step) -> str:
        """Apply all matching actions; return their names."""
        program = self.program
        if missing := self._missing_source(step.stamp_ns):
            text, on_missing = missing
            if on_missing == "forward":
                raise RefusedMessage(text)
            step.dropped = True
            step.note(1.0, f"dropped: {text}")
            return "drop"
        self._forget(step.stamp_ns)
        self._derive()
        applied = []
        if program.always is not None:
            program.always(step)
            applied.append(program.always.name)
        for action in program.actions:
            if action(step):
                applied.append(action.name)
                if program.first_match_only:
                    break
        return "+".join(applied) or PASSTHROUGH

    def _forget(self, now_ns: int) -> None:
        """Remove the expired rows of tables; the oldest come first."""
        for name, lifetime_ns in self.program.lifetimes_ns.items():
            rows = self._shared.state[name]
            while rows:
                oldest = next(iter(rows))
                if now_ns - rows[oldest][STORED_NS] <= lifetime_ns:
                    break
                del rows[oldest]

    def _outputs(self, step: Step) -> list[Output]:
        outputs = []
        if not step.dropped:
            for copy in range(step.copies):
                later_s = step.delay_s + copy * step.spacing_s
                due_ns = step.stamp_ns + round(later_s * SECOND)
                outputs.append(Output(due_ns, step.message, self.program.output_topic))
        outputs += [Output(step.stamp_ns, message, topic) for topic, message in step.emitted]
        return outputs[: self.program.outputs]

    def _truth(
        self, step: Step, stamp_ns: int, operation: str, outputs: list[Output]
    ) -> GroundTruth:
        program = self.program
        magnitude, detail = step.magnitude, "; ".join(step.notes) or "unchanged"
        if operation != PASSTHROUGH and step.notes:
            if program.scenario.control == "shadow":
                magnitude, detail = 0.0, f"withheld: {detail}"
            elif program.magnitude is not None:
                magnitude = float(program.magnitude(step))
        index = self._published
        self._published += len(outputs)
        return GroundTruth(stamp_ns, program.output_topic, index, operation, magnitude, detail)
