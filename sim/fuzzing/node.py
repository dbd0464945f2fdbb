"""The node that a scenario is: it stands between the topic that it hears and the one it speaks on.

What is published instead is worked out in ``sim.fuzzing.execution``, for this node and for a
recorded bag alike. What it changed it tells on the hidden ground-truth topic.
"""

import functools
import math
from typing import Any

from oracle_pipeline.bags.manifest import Change
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE
from sim.fuzzing.execution import Execution, Result
from sim.fuzzing.ground_truth import in_bins
from sim.fuzzing.program import Program
from sim.fuzzing.scenario import Key
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND
from sim.middleware.node import Node, Timer


class ScenarioNode(Node):
    """Run a scenario.

    It hears what was published ``latency_ns`` ago and publishes that much later than its scenario
    says, as over a recorded bag, where nothing takes time.

    Parameters
    ----------
    domain
        Where the node lives; what it hears is there already.
    name
        The same for every scenario of a testbed, so that no graph tells them apart.
    execution
        One run of a program.
    latency_ns
        From the publication of a message to the answer.

    Raises
    ------
    ScenarioError
        If the domain has not what the scenario hears, or has its output under another type.
    """

    def __init__(
        self, domain: Domain, name: str, execution: Execution, *, latency_ns: int = 0
    ) -> None:
        program = execution.program
        _check_topics(domain, program)
        super().__init__(domain, name, latency_ns=latency_ns)
        self._execution = execution
        self._onset_ns: int | None = None
        self._timer: Timer | None = None
        self._changes: list[tuple[int, float]] = []  # when, and how much at most
        self._output = self.create_publisher(program.type.name, program.output_topic)
        self._truth = self.create_publisher(GROUND_TRUTH_TYPE, GROUND_TRUTH_TOPIC)
        for source, spec in program.sources.items():
            hear = functools.partial(self._on_source, source)
            self.create_subscription(spec.type.name, spec.topic, hear, qos.SENSOR_DATA)
        self.create_subscription(
            program.type.name, program.input_topic, self._on_message, qos.SENSOR_DATA
        )

    def begin(self, onset_ns: int) -> None:
        """Let the scenario act from ``onset_ns`` on; until then every message is handed on."""
        self._onset_ns = onset_ns
        period_ns = self._execution.timer_period_ns
        if period_ns is not None:
            first_ns = onset_ns + period_ns + self.latency_ns
            phase_ns = first_ns - self.now_ns
            self._timer = self.create_timer(period_ns, self._on_timer, phase_ns=phase_ns)

    def switch(self, execution: Execution) -> None:
        """Run another scenario from now on, with its onset now.

        Raises
        ------
        ScenarioError
            If it hears or publishes what this node does not.
        """
        program, now = execution.program, self._execution.program
        known = {(name, source.topic, source.type.name) for name, source in now.sources.items()}
        asked = {(name, source.topic, source.type.name) for name, source in program.sources.items()}
        main = (program.input_topic, program.output_topic, program.type.name)
        if main != (now.input_topic, now.output_topic, now.type.name) or not asked <= known:
            raise program.scenario.error(
                ("main",),
                f"expected a scenario from {now.input_topic} to {now.output_topic} with no other "
                f"sources than {', '.join(now.sources) or 'none'}, as that of the node is, found "
                f"{program.input_topic} to {program.output_topic} with "
                f"{', '.join(program.sources) or 'none'}",
            )
        if self._timer is not None:
            self._timer.cancel()
        self._execution = execution
        self.begin(self.now_ns)

    def changes(self, start_ns: int) -> tuple[Change, ...]:
        """Return what was changed since ``start_ns``, in bins of five seconds from there."""
        return in_bins(self._changes, start_ns)

    @property
    def _heard_ns(self) -> int:
        """When what is heard now was published."""
        return self.now_ns - self.latency_ns

    @property
    def _t_s(self) -> float:
        """From the onset to then."""
        if self._onset_ns is None:
            return -math.inf
        return (self._heard_ns - self._onset_ns) / SECOND

    def _on_source(self, source: str, message: Any) -> None:
        if source in self._execution.program.sources:  # it may have been switched to one with less
            self._execution.on_source(source, message, self._heard_ns)

    def _on_message(self, message: Any) -> None:
        self._publish(self._execution.on_message(message, self._heard_ns, self._t_s))

    def _on_timer(self) -> None:
        self._publish(self._execution.on_timer(self._heard_ns, self._t_s))

    def _publish(self, result: Result) -> None:
        for due_ns, message in result.outputs:
            if due_ns > self._heard_ns:
                self.call_later(due_ns - self._heard_ns, self._output.publish, message)
            else:
                self._output.publish(message)
        truth = result.truth
        if truth is not None:
            self._truth.publish(truth.message())
            if truth.magnitude > 0.0:
                self._changes.append((self.now_ns, truth.magnitude))


def _check_topics(domain: Domain, program: Program) -> None:
    """Refuse a scenario that hears what nobody could say."""
    heard: list[tuple[Key, str, str]] = [
        (("sources", name), source.topic, source.type.name)
        for name, source in program.sources.items()
    ]
    heard.append((("main", "input"), program.input_topic, program.type.name))
    for key, topic, msgtype in heard:
        if domain.topics.get(topic) != msgtype:
            same = [name for name, kind in domain.topics.items() if kind == msgtype]
            raise program.scenario.error(
                key,
                f"expected a topic of type {msgtype} that is there ({', '.join(same) or 'none'}), "
                f"found {topic}",
            )
    output = domain.topics.get(program.output_topic, program.type.name)
    if output != program.type.name:
        raise program.scenario.error(
            ("main", "output"),
            f"expected a topic that is no {output}, found {program.output_topic}",
        )
