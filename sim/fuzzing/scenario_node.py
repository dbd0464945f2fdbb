"""The node of a scenario, between the topic that it reads and the topic that it publishes.

A scenario that alters a topic in place has no node: messages are altered at their source, and all
subscribers receive the altered ones. ``sim.fuzzing.execution`` computes them, for the simulator and
for a recorded bag alike. The hidden ground-truth topic reports what was changed.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

from oracle_pipeline.bags.manifest import Change
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE
from sim.fuzzing.execution import Execution, Result
from sim.fuzzing.ground_truth import GroundTruth, in_bins
from sim.fuzzing.program import Program
from sim.fuzzing.scenario import Key
from sim.fuzzing.system_changes import SystemChanges
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.endpoints import Publisher, Sample, Subscription
from sim.middleware.executor import SECOND, Timer
from sim.middleware.node import Node


class ScenarioNode:
    """Run a scenario.

    It receives messages ``latency_ns`` after they were published, and publishes later by the same
    time. Over a recorded bag, there is no latency.

    Parameters
    ----------
    domain
        Domain of the node; the topics that it reads exist already.
    name
        The same for every scenario of a testbed, so that no graph distinguishes them. In place,
        there is no node: the publisher of the topic does its publishing and reading.
    execution
        One run of a program.
    latency_ns
        From the publication of a message to the answer; in place there is none.

    Raises
    ------
    ScenarioError
        If the domain lacks a topic that the scenario reads, or has its output under another type.
    """

    def __init__(
        self, domain: Domain, name: str, execution: Execution, *, latency_ns: int = 0
    ) -> None:
        self._program = program = execution.program
        _check_topics(domain, program)
        self._domain = domain
        self._executor = domain.executor
        self._execution = execution
        self._onset_ns: int | None = None
        self._timer: Timer | None = None
        self._changes: list[tuple[int, float]] = []  # time and largest change
        self._latency_ns = 0 if program.is_in_place else latency_ns
        self._outputs: dict[str, Callable[[Any], None]] = {}
        self._diverted = {lane.output_topic for lane in program.lanes if lane.to}
        self._owner = name
        if program.is_in_place:
            self._owner = next(domain.publishers(program.input_topic)).node
            for lane in program.lanes:
                publisher = next(domain.publishers(lane.input_topic))
                self._outputs[lane.output_topic] = self._sender(publisher)
        else:
            Node(domain, name, latency_ns=latency_ns)
        for topic, kind in program.outlets.items():
            if topic not in self._outputs:
                self._outputs[topic] = self._publisher(topic, kind.name)
        self._publish_truth = self._publisher(GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE)
        self._conditions = SystemChanges(domain, execution)
        for source, spec in program.sources.items():
            self._subscribe(spec.topic, spec.type.name, functools.partial(self._on_source, source))
        for number, lane in enumerate(program.lanes):
            if not program.is_in_place:
                receive = functools.partial(self._on_message, number)
                self._subscribe(lane.input_topic, lane.type.name, receive)
                continue
            for publisher in domain.publishers(lane.input_topic):
                if lane.to:
                    publisher.divert(lane.to, functools.partial(self._on_link, number, publisher))
                else:
                    publisher.alter = functools.partial(self._on_publication, number, publisher)

    def begin(self, onset_ns: int) -> None:
        """Let the scenario act from ``onset_ns`` on; until then, every message is forwarded."""
        self._onset_ns = onset_ns
        period_ns = self._execution.timer_period_ns
        if period_ns is not None:
            first_ns = onset_ns + period_ns + self._latency_ns
            self._timer = self._executor.call_every(period_ns, self._on_timer, first_ns)
        if self._conditions:
            self._executor.call_at(onset_ns, self._on_onset, self._conditions)
            duration_s = self._execution.program.activation.duration_s
            if duration_s is not None:
                end_ns = onset_ns + round(duration_s * SECOND)
                self._executor.call_at(end_ns, self._conditions.undo)

    def end(self, end_ns: int) -> None:
        """Stop the scenario at ``end_ns``."""
        begun = self._onset_ns is not None
        self._execution.end((end_ns - (self._onset_ns or 0)) / SECOND if begun else -math.inf)
        if self._conditions:
            self._executor.call_at(max(end_ns, self._executor.now_ns), self._conditions.undo)

    def switch(self, execution: Execution) -> None:
        """Run another scenario from now on, with its onset now.

        Raises
        ------
        ScenarioError
            If it reads or publishes topics that this node does not.
        """
        program, now = execution.program, self._program
        known = {(name, source.topic, source.type.name) for name, source in now.sources.items()}
        asked = {(name, source.topic, source.type.name) for name, source in program.sources.items()}
        ours, theirs = (
            [(lane.input_topic, lane.output_topic, lane.type.name) for lane in each.lanes]
            for each in (now, program)
        )
        further = program.further_outputs.keys() - self._outputs.keys()
        if ours != theirs or further or not asked <= known:
            raise program.scenario.error(
                ("main",),
                f"expected a scenario from {now.input_topic} to {now.output_topic} with no other "
                f"sources than {', '.join(now.sources) or 'none'}, as that of the node is, found "
                f"{program.input_topic} to {program.output_topic} with "
                f"{', '.join(program.sources) or 'none'}",
            )
        if self._timer is not None:
            self._timer.cancel()
        conditions = SystemChanges(self._domain, execution)
        self._conditions.undo()
        self._execution, self._conditions = execution, conditions
        self.begin(self._executor.now_ns)

    def changes(self, start_ns: int) -> tuple[Change, ...]:
        """Return the changes since ``start_ns``, in bins of five seconds from there."""
        return in_bins(self._changes, start_ns)

    def _publisher(self, topic: str, msgtype: str) -> Any:
        return self._domain.add_publisher(self._owner, msgtype, topic, qos.DEFAULT).publish

    def _subscribe(self, topic: str, msgtype: str, callback: Any) -> None:
        self._domain.add_subscription(
            Subscription(
                self._owner, topic, msgtype, qos.SENSOR_DATA, callback, False, self._latency_ns
            )
        )

    def _sender(self, publisher: Publisher) -> Callable[[Any], None]:
        """Return a function that replaces a publisher's sending, to all or diverted subscribers."""
        is_diverted = publisher.topic in self._diverted
        return publisher.send_diverted if is_diverted else publisher.send

    @property
    def _received_ns(self) -> int:
        """Time at which the present message was published."""
        return self._executor.now_ns - self._latency_ns

    @property
    def _t_s(self) -> float:
        """Time from the onset to that time."""
        if self._onset_ns is None:
            return -math.inf
        return (self._received_ns - self._onset_ns) / SECOND

    def _on_source(self, source: str, message: Any) -> None:
        if source in self._execution.program.sources:  # after a switch, the scenario may have fewer
            self._execution.on_source(source, message, self._received_ns)

    def _on_message(self, number: int, message: Any) -> None:
        lane = self._execution.lanes[number]
        self._publish(lane.on_message(message, self._received_ns, self._t_s))

    def _on_publication(self, number: int, publisher: Publisher, sample: Sample) -> None:
        """Alter a message at its source; an unchanged message keeps its bytes."""
        message = sample.message
        lane = self._execution.lanes[number]
        result = lane.on_message(message, self._received_ns, self._t_s)
        if len(result.outputs) == 1 and result.outputs[0].message is message:
            output = result.outputs[0]
            if output.due_ns == self._received_ns:
                publisher.send(message, sample.data)
                result = result._replace(outputs=[])
        self._publish(result, publisher)

    def _on_link(self, number: int, publisher: Publisher, sample: Sample) -> None:
        """Alter a message on its way to some of its readers."""
        lane = self._execution.lanes[number]
        result = lane.on_message(sample.message, self._received_ns, self._t_s)
        self._publish(result, publisher)

    def _on_timer(self) -> None:
        self._publish(self._execution.on_timer(self._received_ns, self._t_s))

    def _on_onset(self, conditions: SystemChanges) -> None:
        if conditions is self._conditions:  # else the node was switched to another scenario
            for truth in conditions.apply():
                self._report(truth)

    def _publish(self, result: Result, source: Publisher | None = None) -> None:
        for due_ns, message, topic in result.outputs:
            send = self._outputs[topic]
            if source is not None and topic == source.topic:
                send = self._sender(source)
            if due_ns > self._received_ns:
                self._executor.call_at(due_ns + self._latency_ns, send, message)
            else:
                send(message)
        if result.truth is not None:
            self._report(result.truth)

    def _report(self, truth: GroundTruth) -> None:
        """Publish the ground truth, and keep it for the manifest."""
        self._publish_truth(truth.message())
        if truth.magnitude > 0.0:
            self._changes.append((self._executor.now_ns, truth.magnitude))


def _check_topics(domain: Domain, program: Program) -> None:
    """Refuse a scenario that reads topics without a publisher."""
    subscribed: list[tuple[Key, str, str]] = [
        (("sources", name), source.topic, source.type.name)
        for name, source in program.sources.items()
    ]
    keys = list(program.scenario.altered)
    subscribed += [
        ((*key, "input"), lane.input_topic, lane.type.name)
        for key, lane in zip(keys, program.lanes, strict=True)
    ]
    for key, topic, msgtype in subscribed:
        if domain.topics.get(topic) != msgtype:
            same = [name for name, kind in domain.topics.items() if kind == msgtype]
            raise program.scenario.error(
                key,
                f"expected an existing topic of type {msgtype} ({', '.join(same) or 'none'}), "
                f"found {topic}",
            )
    for key, lane in zip(keys, program.lanes, strict=True):
        if program.is_in_place and not any(domain.publishers(lane.input_topic)):
            raise program.scenario.error(
                (*key, "output"), f"expected a topic with a publisher, found {lane.input_topic}"
            )
        readers = sorted({each.node for each in domain.subscriptions(lane.input_topic)})
        for number, node in enumerate(lane.to):
            if node not in readers:
                raise program.scenario.error(
                    (*key, "to", number),
                    f"expected a node that subscribes to {lane.input_topic} "
                    f"({', '.join(readers)}), found {node}",
                )
    outputs: list[Key] = [(*key, "output") for key in keys]
    outputs += [("outputs", name, "topic") for name in program.scenario.document.get("outputs", {})]
    for key, (topic, kind) in zip(outputs, program.outlets.items(), strict=True):
        known = domain.topics.get(topic, kind.name)
        if known != kind.name:
            raise program.scenario.error(key, f"expected a topic that is no {known}, found {topic}")
