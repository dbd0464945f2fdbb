"""Uncertainty of localisation, and its corrections of odometry.

An attack on scans that localisation does not use does not change these features.
"""

from typing import Any

import numpy as np

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.common_fields import header_stamps_s, poses_of
from oracle_pipeline.features.geometry.odometry_path import ODOMETRY_POSES, OdometryPath
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.geometry.scans import Floats
from oracle_pipeline.features.geometry.transform_tree import TransformTree
from oracle_pipeline.features.statistics.reduction import quantile
from oracle_pipeline.robots.roles import PLAN, POSE

_BELIEF_FEATURES = (
    fp.Feature("position_spread", "m", 0.01,
        "standard deviation of the estimated position (square root of var x + var y), median",
        "navigation"),
    fp.Feature("yaw_spread", "rad", 0.01, "standard deviation of the yaw, median", "navigation"),
)  # fmt: skip
_CORRECTION_FEATURES = (
    fp.Feature("position_correction", "m", 0.01,
        "distance of a pose from the previous pose propagated by odometry, median", "navigation"),
    fp.Feature("yaw_correction", "rad", 0.005,
        "yaw of a pose relative to the previous pose propagated by odometry, median", "navigation"),
)  # fmt: skip
PLAN_FEATURES = (
    fp.Feature("plan_offset", "m", 0.02,
        "distance from the robot's estimated position to the start of its plan, median",
        "navigation"),
)  # fmt: skip


def _keep_belief(messages: Any) -> tuple[Floats, ...]:
    """Return stamp, x, y, yaw, variance of the position and variance of the yaw of poses."""
    covariance = messages.pose.covariance
    return (
        header_stamps_s(messages), *poses_of(messages.pose.pose),
        covariance[:, 0] + covariance[:, 7], covariance[:, 35],
    )  # fmt: skip


def _compute_belief(window: fp.Window) -> fp.Values:
    """Compute from the poses in the window."""
    (poses,) = window.topics["poses"].values()
    spread = np.sqrt(np.maximum(0.0, poses.values[:, 4:]))
    position, yaw = np.median(spread, axis=0)
    return {"position_spread": float(position), "yaw_spread": float(yaw)}


def _prepare_corrections(window: fp.Window) -> tuple[fp.Series, fp.Series]:
    """Return the difference of each pose from the predicted one: distance [m] and yaw [rad]."""
    (poses,) = window.topics["poses"].values()
    (odometry,) = window.topics["odometry"].values()
    stamps_s, x, y, yaw, *_ = poses.values.T
    believed = PlanarPose.of(x, y, yaw)
    driven = OdometryPath(odometry, TransformTree({})).base(stamps_s)
    before, now = slice(None, -1), slice(1, None)
    moved = driven.at(before).inverse().compose(driven.at(now))
    predicted = believed.at(before).compose(moved)
    times_s = poses.times_s[1:]
    return (
        fp.Series(times_s, np.abs(believed.translation[now] - predicted.translation)),
        fp.Series(times_s, np.abs(np.angle(believed.rotation[now] / predicted.rotation))),
    )


def _compute_corrections(window: fp.Window) -> fp.Values | fp.Missing:
    """Reduce to the window."""
    position, yaw = (quantile(series, window, 0.5) for series in window.prepared)
    if np.isnan(position):
        return fp.Missing("fewer than two poses of localisation")
    return {"position_correction": position, "yaw_correction": yaw}


def _keep_plan_starts(messages: Any) -> tuple[Floats, Floats, Floats]:
    """Return stamp and first position of ``nav_msgs/msg/Path``s; NaN for an empty one."""
    first = np.searchsorted(messages.poses.owners, np.arange(len(messages)))
    empty = np.bincount(messages.poses.owners, minlength=len(messages)) == 0
    position = messages.poses.pose.position
    x, y = (
        np.where(empty, np.nan, np.append(column, np.nan)[first])
        for column in (position.x, position.y)
    )
    return header_stamps_s(messages), x, y


def _prepare_plan_offsets(window: fp.Window) -> fp.Series:
    """Return the distance from the robot to the start of each plan [m]."""
    (plans,), (poses,), (odometry,) = (
        window.topics[name].values() for name in ("plan", "poses", "odometry")
    )
    stamps_s, x, y = plans.values.T
    at_s, *believed = poses.values[np.argsort(poses.values[:, 0], kind="stable"), :4].T
    last = np.searchsorted(at_s, stamps_s, side="right") - 1
    place = PlanarPose.of(*believed).at(last)
    driven = OdometryPath(odometry, TransformTree({}))
    moved = driven.base(at_s[last]).inverse().compose(driven.base(stamps_s))
    offset = np.abs(x + 1j * y - place.compose(moved).translation)
    return fp.Series(plans.times_s, np.where(last >= 0, offset, np.nan))


def _compute_plan_offsets(window: fp.Window) -> fp.Values | fp.Missing:
    """Reduce to the window."""
    offset = quantile(window.prepared, window, 0.5)
    return fp.Missing("no plan in this window") if np.isnan(offset) else {"plan_offset": offset}


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of localisation."""
    poses = {"poses": fp.Request(_keep_belief, role=POSE, many=True)}
    odometry = {"odometry": ODOMETRY_POSES}
    plans = {"plan": fp.Request(_keep_plan_starts, role=PLAN, many=True)}
    return [
        fp.FeaturePlugin("belief", "navigation", _BELIEF_FEATURES, _compute_belief, poses),
        fp.FeaturePlugin(
            "corrections", "navigation", _CORRECTION_FEATURES, _compute_corrections,
            poses | odometry, prepare=_prepare_corrections,
        ),
        fp.FeaturePlugin(
            "plan_offsets", "navigation", PLAN_FEATURES, _compute_plan_offsets,
            poses | odometry | plans, prepare=_prepare_plan_offsets,
        ),
    ]  # fmt: skip
