"""The detector panel: from scaled features of normal runs to a score of any one run.

Detectors are scikit-learn estimators; a verdict with a known false-alarm rate is made of their
scores in ``oracle_pipeline.evaluation.conformal``.
"""

from oracle_pipeline.detectors.base import Detector, DetectorError
from oracle_pipeline.detectors.explain import Deviation, explain
from oracle_pipeline.detectors.panel import DEFAULT_DETECTOR, panel, pipeline, upper_bounds

__all__ = [
    "DEFAULT_DETECTOR",
    "Detector",
    "DetectorError",
    "Deviation",
    "explain",
    "panel",
    "pipeline",
    "upper_bounds",
]
