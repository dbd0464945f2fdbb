"""The verdict on one recording: normal or anomalous, with p-values and evidence."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.detectors import FamilyDeviation

Judgement: TypeAlias = Literal["normal", "anomalous", "error"]


class ScoringError(OracleError):
    """A recording cannot be judged against this reference."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """One feature outside its usual range; where and when it was attained, if that is known."""

    feature: str
    z: float  # robust, in the scales of the same normal runs
    capped: bool  # z would be larger
    value: float
    unit: str
    usual_low: float  # 5th and 95th percentile of the normal runs
    usual_high: float
    where: str | None = None  # a topic, a pair of topics or an edge
    window_start_s: float | None = None  # of the window that is farthest out in the same direction


@dataclass(frozen=True, slots=True)
class Verdict:
    """The judgement of one recording and all that it rests on; an error has no numbers."""

    recording: str
    outcome: Judgement
    p_value: float | None = None  # among the calibration runs
    p_value_by_block: float | None = None  # the same, each block counting once
    suite_p_value: float | None = None  # adjusted for the recordings judged together
    detector: str = ""
    score: float | None = None  # the detector's, higher is more anomalous
    features: int = 0
    fit_runs: int = 0
    calibration_runs: int = 0
    calibration_blocks: int = 0
    evidence: tuple[Evidence, ...] = ()  # largest distance first
    families: tuple[FamilyDeviation, ...] = ()  # of all features outside their usual range
    notes: tuple[str, ...] = ()
    error: str = ""
