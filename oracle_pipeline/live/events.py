"""What happens while a domain is watched, as events for its readers."""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.scoring.contract import Breach
from oracle_pipeline.scoring.verdict import Evidence


@dataclass(frozen=True, slots=True)
class MessageReceived:
    """A message as it was received."""

    topic: str
    msgtype: str
    stamp_ns: int  # in the recording's time
    data: bytes  # CDR with its encapsulation header


@dataclass(frozen=True, slots=True)
class GraphTaken:
    """The ROS graph of an interval that has ended."""

    start_s: int  # since the start of the recording
    graph: RosGraph


@dataclass(frozen=True, slots=True)
class WindowVerdict:
    """The verdict on one window of a recording in progress."""

    start_s: float  # since the start of the recording
    end_s: float
    score: float  # higher is more anomalous
    p_value: float  # share of normal windows that score at least as high
    is_usual: bool  # it adds nothing to the alarm statistic
    alarm: bool  # it raised an alarm
    evidence: tuple[Evidence, ...] = ()  # the features farthest from usual
    latency_s: float = 0.0  # wall time from the end of the window to the verdict
    timed: bool = True  # whether features of rate and timing counted
    alarm_score: float = 0.0  # above it, one window raises an alarm by itself
    robot: str = ""  # its namespace; empty if it is the only one
    judged: bool = True  # false while the robot starts or leaves: the score says nothing


@dataclass(frozen=True, slots=True)
class WindowAlarm:
    """The rule of the card raised an alarm with this window."""

    verdict: WindowVerdict


@dataclass(frozen=True, slots=True)
class ContractAlarm:
    """The robot departs from the contract of its normal recordings."""

    at_s: float  # since the start of the recording
    breaches: tuple[Breach, ...]


@dataclass(frozen=True, slots=True)
class Note:
    """A remark for people, such as on dropped messages or a topic that cannot be read."""

    text: str
    kept: Path | None = None  # the recording that the black box has kept


Event: TypeAlias = MessageReceived | GraphTaken | WindowVerdict | WindowAlarm | ContractAlarm | Note
