"""Applies a scenario to a recorded bag, as its node would have done, without a simulator.

The mutant is the bag with the output topic added, or in place of the one that was recorded, and
with the scenario's own ground truth. All other topics keep their messages, stamps and QoS. A
scenario that ``oracle-sim mutate --topic`` gives another topic alters it in place.
"""

import dataclasses
import functools
import heapq
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.manifest import Change, TopicCount
from oracle_pipeline.bags.reader import BagReader, RawMessage
from oracle_pipeline.bags.types import (
    GROUND_TRUTH_TOPIC,
    GROUND_TRUTH_TYPE,
    message_class,
    serialize,
)
from oracle_pipeline.bags.writer import BagWriter
from sim.fuzzing.execution import PASSTHROUGH, Execution, Result, execute
from sim.fuzzing.ground_truth import in_bins
from sim.fuzzing.program import Program
from sim.middleware import qos
from sim.middleware.executor import SECOND

_STATUS_TOPIC = "/navigate_to_pose/_action/status"
_LOG_TOPIC = "/behavior_tree_log"
_UNDER_WAY = (1, 2, 3)  # accepted, executing, canceling in action_msgs/msg/GoalStatus
_ROOT = "NavigateRecovery"  # root node of Nav2's behaviour trees


@dataclass(frozen=True, slots=True)
class Summary:
    """A summary of the changes to a bag."""

    onset_s: float  # in seconds of the recording
    received: int  # messages of the input topic while the node existed
    touched: int  # altered messages, including ticks of the timer
    published: int  # messages on the output topic
    changes: tuple[Change, ...]  # changes over time
    topics: Mapping[str, TopicCount]  # of the mutant
    content_hash: str  # of the mutant
    notes: tuple[str, ...] = ()  # what was not read of the bag, and other remarks on it


Progress = Callable[..., Iterable[RawMessage]]  # of messages, and their ``total`` number


def mutate_bag(
    bag_in: Path, bag_out: Path, program: Program, run_seed: int, at_s: float | None = None,
    parameters: Mapping[str, Any] | None = None, track: Progress = lambda messages, **_: messages,
    goals_s: Sequence[float] | None = None,
) -> Summary:  # fmt: skip
    """Run a program over a bag.

    Parameters
    ----------
    bag_in : Path
        A rosbag2 of either storage; it is only read.
    bag_out : Path
        Path of the mutant, in the same storage; must not exist.
    program : Program
        The program to apply.
    run_seed : int
        Seed of its draws, together with the scenario's seed.
    at_s : float, optional
        Onset in seconds of the recording; by default that of the scenario, for which the bag
        may have to show when a goal was accepted.
    parameters : mapping, optional
        Values in place of those drawn by the seed, or of the defaults.
    track : callable, optional
        Takes the bag's messages and their number, and yields the messages: a progress bar.
    goals_s : sequence of float, optional
        When each goal was accepted, in seconds of the recording; by default as the bag shows.

    Raises
    ------
    BagError
        If the bag cannot be read or written, lacks a topic, or does not show the onset.
    ScenarioError
        If a parameter cannot have its value.
    """
    execution = execute(program, run_seed, parameters)
    with BagReader(bag_in) as recorded:
        reader = _in_cdr(recorded)
        _check_topics(reader, program)
        # The bag is searched once, and only if it has to be.
        accepted_ns = functools.cache(functools.partial(_accepted_ns, reader, goals_s))
        onset_ns = _onset_ns(reader, program, accepted_ns, at_s, run_seed)
        until = program.activation.until_goal
        if until is not None and (end_ns := _of_goal(accepted_ns(), until)) is not None:
            execution.end((end_ns - onset_ns) / SECOND)
        with BagWriter(bag_out, _storage(bag_in)) as writer:
            run = _Run(reader, writer, execution, onset_ns)
            for message in track(reader.messages(), total=reader.message_count):
                run.take(message)
            run.finish()
    return Summary(
        onset_s=(onset_ns - reader.start_ns) / SECOND, received=run.received, touched=run.touched,
        published=sum(writer.counts[lane.output_topic] for lane in program.lanes),
        changes=in_bins(run.changes, reader.start_ns), topics=writer.topics,
        content_hash=writer.content_hash, notes=(*reader.losses, *reader.notes),
    )  # fmt: skip


class _Run:
    """The conversion of one bag into another, in order of time."""

    def __init__(
        self, reader: BagReader, writer: BagWriter, execution: Execution, onset_ns: int
    ) -> None:
        self._reader = reader
        self._writer = writer
        self._execution = execution
        self._program = program = execution.program
        self._onset_ns = onset_ns
        self._due: list[tuple[int, int, str, bytes]] = []  # messages still to be written
        self._order = itertools.count()
        self._decoded: set[str] = set()
        self._source_names: dict[str, list[str]] = {}
        for name, source in program.sources.items():
            self._source_names.setdefault(source.topic, []).append(name)
        period_ns = execution.timer_period_ns
        self._beats = itertools.count(onset_ns + period_ns, period_ns) if period_ns else None
        self._beat_ns = next(self._beats) if self._beats else None
        self.received = 0
        self.touched = 0
        self.changes: list[tuple[int, float]] = []  # time and largest change
        for topic in reader.topics.values():
            defined = reader.definition(topic.msgtype)
            writer.add_topic(topic.name, topic.msgtype, topic.qos, defined)
        self._lanes = {lane.program.input_topic: lane for lane in execution.lanes}
        self._replaced = {lane.output_topic for lane in program.lanes}
        for name, kind in program.outlets.items():
            if name not in reader.topics:
                writer.add_topic(name, kind.name, [qos.DEFAULT])
        writer.add_topic(GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE, [qos.DEFAULT])

    def take(self, raw: RawMessage) -> None:
        """Take the next message of the bag."""
        self._advance(raw.stamp_ns)
        if raw.topic not in self._replaced:
            self._writer.write(*raw)
        if raw.stamp_ns < self._onset_ns and self._program.activation.before == "absent":
            if self._program.is_in_place and raw.topic in self._lanes:
                self._writer.write(*raw)  # unaltered
            return
        for name in self._source_names.get(raw.topic, ()):
            self._execution.on_source(name, self._decode(raw), raw.stamp_ns)
        if (lane := self._lanes.get(raw.topic)) is not None:
            self.received += 1
            message = self._decode(raw)
            result = lane.on_message(message, raw.stamp_ns, self._t_s(raw.stamp_ns))
            self._publish(result, raw.stamp_ns, message, raw.data)
            self._write_due(raw.stamp_ns)

    def finish(self) -> None:
        """Write the messages that are due until the end of the recording."""
        self._advance(self._reader.end_ns)

    def _advance(self, now_ns: int) -> None:
        """Run the timer, and write the messages that are due, up to a time."""
        while self._beats is not None and self._beat_ns is not None and self._beat_ns <= now_ns:
            self._write_due(self._beat_ns)
            result = self._execution.on_timer(self._beat_ns, self._t_s(self._beat_ns))
            self._publish(result, self._beat_ns)
            self._beat_ns = next(self._beats)
        self._write_due(now_ns)

    def _write_due(self, now_ns: int) -> None:
        while self._due and self._due[0][0] <= now_ns:
            due_ns, _, topic, data = heapq.heappop(self._due)
            self._writer.write(topic, due_ns, data)

    def _publish(self, result: Result, now_ns: int, message: Any = None, data: bytes = b"") -> None:
        """Queue the outputs of a message or the timer; an unchanged message keeps its bytes."""
        for due_ns, output, topic in result.outputs:
            same = output is message
            self._put(due_ns, topic, data if same else serialize(output, output.__msgtype__))
        if result.truth is not None:
            self.touched += result.truth.operation != PASSTHROUGH
            if result.truth.magnitude > 0.0:
                self.changes.append((now_ns, result.truth.magnitude))
            truth = serialize(result.truth.message(), GROUND_TRUTH_TYPE)
            self._put(now_ns, GROUND_TRUTH_TOPIC, truth)

    def _put(self, due_ns: int, topic: str, data: bytes) -> None:
        heapq.heappush(self._due, (due_ns, next(self._order), topic, data))

    def _decode(self, raw: RawMessage) -> Any:
        message = self._reader.deserialize(raw)
        if raw.topic not in self._decoded:
            self._decoded.add(raw.topic)
            msgtype = self._reader.topics[raw.topic].msgtype
            if not _is_alike(message, msgtype):
                raise BagError(
                    f"{self._reader.path} defines {msgtype} differently from the "
                    f"built-in type, so {raw.topic} cannot be mutated; put its "
                    "definition into oracle_pipeline/bags/msg."
                )
        return message

    def _t_s(self, stamp_ns: int) -> float:
        return (stamp_ns - self._onset_ns) / SECOND


def _is_alike(message: Any, msgtype: str) -> bool:
    """Return whether a message decoded by the bag's definition has the built-in type's fields."""
    theirs, ours = type(message), message_class(msgtype)
    if theirs is ours:
        return True
    fields, known = ([(f.name, f.type) for f in dataclasses.fields(c)] for c in (theirs, ours))
    values = [getattr(message, name) for name, _ in fields]
    firsts = [v[0] if isinstance(v, list) and v else v for v in values]
    nested = [v for v in firsts if hasattr(v, "__msgtype__")]
    return fields == known and all(_is_alike(value, value.__msgtype__) for value in nested)


def _check_topics(reader: BagReader, program: Program) -> None:
    """Refuse a bag without the topics that the scenario reads."""
    for lane in program.lanes:
        if lane.to:
            raise BagError(
                f"{program.scenario.id} alters what {', '.join(lane.to)} receives of "
                f"{lane.input_topic}. A bag shows what the recorder receives, which is not "
                "altered; record the scenario in closed loop."
            )
    if program.scenario.needs_simulator:
        raise BagError(
            f"{program.scenario.id} changes parameters of nodes, or QoS. A bag cannot show how "
            "nodes would have acted; record the scenario in closed loop."
        )
    needed = {source.topic: source.type.name for source in program.sources.values()}
    needed |= {lane.input_topic: lane.type.name for lane in program.lanes}
    for name, msgtype in needed.items():
        if name not in reader.topics:
            same = [topic.name for topic in reader.topics.values() if topic.msgtype == msgtype]
            hint = (
                f"of type {msgtype} it has {', '.join(same)}. Name one of these with "
                "--topic, or in the scenario."
                if same
                else f"nor any other of type {msgtype}. Choose a scenario for what it has."
            )
            raise BagError(
                f"{reader.path} has no topic {name}, which {program.scenario.id} subscribes to; "
                f"{hint}"
            )
    spoken = {topic: kind.name for topic, kind in program.outlets.items()}
    for name, msgtype in {**needed, **spoken}.items():
        if name in reader.topics and reader.topics[name].msgtype != msgtype:
            raise BagError(
                f"{reader.path} has {name} as {reader.topics[name].msgtype}, "
                f"{program.scenario.id} needs {msgtype}."
            )


def _in_cdr(reader: BagReader) -> BagReader:
    """Return the bag without topics that a rosbag2 cannot hold; the notes name them.

    Raises
    ------
    BagError
        If it has messages of ROS 1, which can be converted, or no others.
    """
    others = [topic for topic in reader.topics.values() if topic.encoding != "cdr"]
    for topic in others:
        if topic.encoding == "ros1":
            raise BagError(
                f"{reader.path} has {topic.name} encoded as 'ros1', but a rosbag2 holds only CDR. "
                "Convert the ROS 1 .bag file that it comes from with `rosbags-convert --src "
                "FILE.bag --dst FOLDER`, and mutate FOLDER."
            )
    if others and len(others) == len(reader.topics):
        raise BagError(
            f"{reader.path} has no topic encoded as CDR ({others[0].name} is "
            f"{others[0].encoding!r}), and a rosbag2 holds only CDR. Convert it with the tool that "
            "recorded it."
        )
    reader.notes += [
        f"{topic.name} is left out: its messages ({topic.count}) are encoded as "
        f"{topic.encoding!r}, and a rosbag2 holds only CDR."
        for topic in others
    ]
    return reader.renamed({t.name: t.name for t in reader.topics.values() if t not in others})


def _accepted_ns(reader: BagReader, accepted_s: Sequence[float] | None) -> list[int]:
    """Return when each goal was accepted.

    Without ``accepted_s``, in seconds of the recording, the bag is searched for it.
    """
    if accepted_s is None:
        return list(_goals_ns(reader))
    return [reader.start_ns + round(s * SECOND) for s in accepted_s]


def _of_goal(stamps_ns: Sequence[int], number: int) -> int | None:
    """Return the stamp of a goal, counted from 1; None if the recording shows none."""
    return stamps_ns[number - 1] if number <= len(stamps_ns) else None


def _onset_ns(
    reader: BagReader,
    program: Program,
    accepted_ns: Callable[[], Sequence[int]],
    at_s: float | None,
    run_seed: int,
) -> int:
    activation = program.activation
    if at_s is not None:
        return reader.start_ns + round(at_s * SECOND)
    begin_ns: int | None = reader.start_ns
    if activation.after == "goal_accepted":
        begin_ns = _of_goal(accepted_ns(), activation.goal)
    if begin_ns is None:
        raise BagError(
            f"{reader.path} does not show when goal {activation.goal} was accepted "
            f"({_STATUS_TOPIC}, {_LOG_TOPIC}); say when {program.scenario.id} is to begin, in "
            "seconds of the recording."
        )
    return begin_ns + round(activation.delay_s(run_seed) * SECOND)


def _goals_ns(reader: BagReader) -> Iterator[int]:
    """Yield when each goal was under way, by the action's status or else by the tree's."""
    status = reader.topics.get(_STATUS_TOPIC)
    if status is not None and status.count:
        known = set[bytes]()
        for raw in reader.messages([_STATUS_TOPIC]):
            for goal in reader.deserialize(raw).status_list:
                name = bytes(goal.goal_info.goal_id.uuid)
                if goal.status in _UNDER_WAY and name not in known:
                    known.add(name)
                    yield raw.stamp_ns
        return
    for raw in reader.messages([_LOG_TOPIC]):
        for change in reader.deserialize(raw).event_log:
            if change.node_name == _ROOT and change.current_status == "RUNNING":
                yield raw.stamp_ns


def _storage(path: Path) -> Literal["mcap", "sqlite3"]:
    files = path.iterdir() if path.is_dir() else [path]
    return "sqlite3" if any(".db3" in file.name for file in files) else "mcap"
