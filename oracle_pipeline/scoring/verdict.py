"""The verdict on one recording: normal or anomalous, with p-values and evidence."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.scoring.alarms import Alarm

if TYPE_CHECKING:
    from oracle_pipeline.detectors import FamilyDeviation

# Breach: not anomalous by its features, but it breaks the contract of the system.
# Unsupported: there is a score, but too few normal runs for a verdict at the requested rate.
# Another system: the reference has too little in common with the recording to compare them.
Judgement: TypeAlias = Literal[
    "normal", "breach", "anomalous", "unsupported", "another system", "error"
]


class ScoringError(OracleError):
    """A recording cannot be judged against this reference."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """One feature outside its usual range; where and when it was attained, if known."""

    feature: str
    z: float  # robust, relative to the same normal runs
    capped: bool  # whether the true |z| is larger
    value: float
    unit: str
    usual_low: float  # 5th and 95th percentile of the normal runs
    usual_high: float
    where: str | None = None  # a topic, a pair of topics or an edge
    window_start_s: float | None = None  # of the time around the window that deviates most
    window_end_s: float | None = None  # of that time; None: the end of the recording, or unknown


@dataclass(frozen=True, slots=True)
class WindowSeries:
    """A feature in the windows of a recording, and its range in normal windows, None if unknown."""

    feature: str
    unit: str
    start_s: tuple[float, ...]  # of each window
    values: tuple[float | None, ...]  # None where it is missing
    normal_low: float | None
    normal_high: float | None


@dataclass(frozen=True, slots=True)
class AspectScore:
    """Score of a recording in one aspect: tampering or misbehaviour."""

    p_value: float  # among the normal blocks, from the features of the aspect alone
    suite_p_value: float  # adjusted for the recordings judged together
    score: float


@dataclass(frozen=True, slots=True)
class CardOrigin:
    """The reference card that a verdict is based on; empty where it is not known."""

    sha256: str = ""  # of the file
    release: str = ""  # of the oracle that learned it
    learned: str = ""  # day, ISO 8601

    def __str__(self) -> str:
        return (
            f"Card: SHA-256 {self.sha256[:16]}, learned {self.learned or 'on an unknown day'} by "
            f"release {self.release or 'unknown'}."
        )


@dataclass(frozen=True, slots=True)
class Verdict:
    """The outcome for one recording with its basis; an error has no numbers."""

    recording: str
    outcome: Judgement
    contract: tuple[str, ...] = ()  # breaches by topics, types, QoS, rates and graph, as sentences
    p_value: float | None = None  # share of normal blocks that score at least as high
    suite_p_value: float | None = None  # adjusted for the recordings judged together
    score: float | None = None  # 0 is the median of normal runs, 1 their spread
    aspects: Mapping[str, AspectScore] = field(default_factory=dict)  # those with features
    alarms: tuple[Alarm, ...] = ()  # in order of time
    alarms_per_h: float | None = None  # promised false alarms per hour; None: no windows
    features: int = 0
    normal_runs: int = 0
    normal_blocks: int = 0  # that vote
    evidence: tuple[Evidence, ...] = ()  # largest distance first
    families: "tuple[FamilyDeviation, ...]" = ()  # of all features outside their usual range
    notes: tuple[str, ...] = ()
    error: str = ""
    cautions: tuple[str, ...] = ()  # what a reader has to know before all else
    in_common: float | None = None  # share of roles, topics and types that the reference has too
    differences: tuple[str, ...] = ()  # of another system, the largest first
    card: CardOrigin | None = None  # None: learned for this verdict
    series: tuple[WindowSeries, ...] = ()  # of the evidence that windows have
