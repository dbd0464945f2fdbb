"""The compared detectors, in a fixed order, and the pipeline of scaler and detector.

The panel is fixed in advance, because choosing among many by result overfits a small campaign.
docs/explanation/detectors.md describes strengths and pitfalls of each. Detectors of installed
packages follow: an entry point of the group `PLUGINS` names a class or function that returns one.
"""

import importlib.metadata
from collections.abc import Mapping

from sklearn.ensemble import IsolationForest
from sklearn.pipeline import Pipeline

from oracle_pipeline.clustering.scaling import FlooredRobustScaler
from oracle_pipeline.detectors.base import Detector, DetectorError
from oracle_pipeline.detectors.distances import LargestZ, Mahalanobis, PrincipalComponents

DEFAULT_DETECTOR = "mahalanobis"  # docs/explanation/detectors.md gives the reasons
PLUGINS = "oracle_pipeline.detectors"  # group of entry points


def panel(seed: int) -> dict[str, Detector]:
    """Return the detectors by name, unfitted; `seed` is for randomised ones."""
    return {
        DEFAULT_DETECTOR: Mahalanobis(),
        "isolation_forest": IsolationForest(n_estimators=300, random_state=seed),
        "pca": PrincipalComponents(),
        "z_3": LargestZ(3),
        "z_10": LargestZ(10),
        **_plugged(),
    }


def named_detector(name: str, seed: int) -> Detector:
    """Return an unfitted detector of the panel.

    Raises
    ------
    DetectorError
        There is none of this name.
    """
    known = panel(seed)
    if name not in known:
        raise DetectorError(
            f"There is no detector {name!r}; known are {', '.join(known)}. Others come with "
            f"installed packages that have an entry point in the group {PLUGINS}."
        )
    return known[name]


def _plugged() -> dict[str, Detector]:
    """Return the detectors of installed packages, unfitted, by name."""
    found = importlib.metadata.entry_points(group=PLUGINS)
    return {point.name: _made(point) for point in sorted(found, key=lambda point: point.name)}


def _made(point: importlib.metadata.EntryPoint) -> Detector:
    try:
        detector: Detector = point.load()()
        detector.fit, detector.score_samples  # noqa: B018 -- LOF needs novelty=True to score
    except Exception as error:
        raise DetectorError(
            f"The detector {point.name} ({point.value}) cannot be made: {error}. It must return an "
            "unfitted estimator with fit and score_samples; correct or uninstall its package."
        ) from error
    return detector


def pipeline(detector: Detector, floors: Mapping[str, float] | None = None) -> Pipeline:
    """Return the pipeline of scaler and detector, for a DataFrame of features.

    Parameters
    ----------
    detector : Detector
    floors : mapping of str to float, optional
        Resolution of a column, in its unit (`datasets.feature_floors`).
    """
    return Pipeline([("scaler", FlooredRobustScaler(floors)), ("detector", detector)])
