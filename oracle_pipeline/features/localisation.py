"""How sure localisation was of itself, and how much it corrected odometry.

An attack on scans that localisation does not use leaves these as they are.
"""

from typing import Any

import numpy as np

from oracle_pipeline.features.parts import header_stamps_s, poses_of
from oracle_pipeline.features.plugin import (
    Feature,
    FeaturePlugin,
    Missing,
    Request,
    Series,
    Values,
    Window,
    hookimpl,
)
from oracle_pipeline.features.reduction import quantile
from oracle_pipeline.features.scan_geometry import (
    Frames,
    Motion,
    Planar,
    keep_odometry,
)
from oracle_pipeline.features.scans import Floats
from oracle_pipeline.robots.roles import ODOMETRY, POSE

BELIEF_FEATURES = (
    Feature(
        "position_spread", "m", 0.01,
        "standard deviation of the position (square root of the covariance's trace), median",
        "navigation",
    ),
    Feature("yaw_spread", "rad", 0.01, "standard deviation of the yaw, median", "navigation"),
)  # fmt: skip
CORRECTION_FEATURES = (
    Feature(
        "position_correction", "m", 0.01,
        "distance of a pose from where odometry leads from the one before, median", "navigation",
    ),
    Feature("yaw_correction", "rad", 0.005, "the same of the yaw, median", "navigation"),
)  # fmt: skip


def keep_belief(messages: Any) -> tuple[Floats, ...]:
    """Return poses and their covariances: stamp, x, y, yaw, position and yaw variance."""
    covariance = messages.pose.covariance
    return (
        header_stamps_s(messages), *poses_of(messages.pose.pose),
        covariance[:, 0] + covariance[:, 7], covariance[:, 35],
    )  # fmt: skip


def compute_belief(window: Window) -> Values:
    """Compute from the poses in the window."""
    (poses,) = window.topics["poses"].values()
    spread = np.sqrt(np.maximum(0.0, poses.values[:, 4:]))
    position, yaw = np.median(spread, axis=0)
    return {"position_spread": float(position), "yaw_spread": float(yaw)}


def prepare_corrections(window: Window) -> tuple[Series, Series]:
    """Return how far each pose is from the predicted one: distance [m] and yaw [rad]."""
    (poses,) = window.topics["poses"].values()
    (odometry,) = window.topics["odometry"].values()
    stamps_s, x, y, yaw, *_ = poses.values.T
    believed = Planar(x + 1j * y, np.exp(1j * yaw))
    driven = Motion(odometry, Frames({})).base(stamps_s)
    before, now = slice(None, -1), slice(1, None)
    moved = driven.at(before).inverse().compose(driven.at(now))
    predicted = believed.at(before).compose(moved)
    times_s = poses.times_s[1:]
    return (
        Series(times_s, np.abs(believed.shift[now] - predicted.shift)),
        Series(times_s, np.abs(np.angle(believed.turn[now] / predicted.turn))),
    )


def compute_corrections(window: Window) -> Values | Missing:
    """Reduce to the window."""
    position, yaw = (quantile(series, window, 0.5) for series in window.prepared)
    if np.isnan(position):
        return Missing("localisation gave no two poses")
    return {"position_correction": position, "yaw_correction": yaw}


@hookimpl
def register_features() -> list[FeaturePlugin]:
    """Offer the features of localisation."""
    poses = {"poses": Request(keep_belief, role=POSE, many=True)}
    odometry = {"odometry": Request(keep_odometry, role=ODOMETRY, dtype=object, many=True)}
    return [
        FeaturePlugin("belief", "navigation", BELIEF_FEATURES, compute_belief, poses),
        FeaturePlugin(
            "corrections", "navigation", CORRECTION_FEATURES, compute_corrections,
            poses | odometry, prepare=prepare_corrections,
        ),
    ]  # fmt: skip
