"""The detector panel: detectors are fitted on scaled features of normal runs, and score any run.

Detectors are scikit-learn estimators. ``oracle_pipeline.scoring.conformal`` turns their scores
into verdicts with a known false positive rate.
"""

from oracle_pipeline.detectors.base import Detector, DetectorError, single_threaded
from oracle_pipeline.detectors.distances import BeyondRange, Mahalanobis
from oracle_pipeline.detectors.explain import Deviation, FamilyDeviation, UsualRanges, by_family
from oracle_pipeline.detectors.groups import LargestGroup, SignalScaler
from oracle_pipeline.detectors.panel import DEFAULT_DETECTOR, named_detector, panel, pipeline

__all__ = [
    "DEFAULT_DETECTOR", "BeyondRange", "Detector", "DetectorError", "Deviation", "FamilyDeviation",
    "LargestGroup", "Mahalanobis", "SignalScaler", "UsualRanges", "by_family",
    "named_detector", "panel", "pipeline", "single_threaded",
]  # fmt: skip
