"""Whether transforms, odometry and localisation agree on the robot's pose.

Odometry is published twice, as a message and as a transform. A localisation's pose must equal the
combination of its transform and that of odometry. The frames in a message determine which
transforms belong to it.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.common_fields import frame_names, header_stamps_s, poses_of
from oracle_pipeline.features.geometry.odometry_path import keep_odometry
from oracle_pipeline.features.geometry.planar_pose import PlanarPose, PosePath
from oracle_pipeline.features.geometry.scans import Floats
from oracle_pipeline.features.motion.ego_motion import MOVING, MovingTransform, edges
from oracle_pipeline.features.statistics.reduction import largest, quantile
from oracle_pipeline.features.statistics.times import nearest

_TOPICS = "over the topics and transforms"
FEATURES = (
    fp.Feature("odometry_position", "m", 5e-3,
        "distance between the pose of odometry and its transform with the same stamp, 95th "
        f"percentile, maximum {_TOPICS}", "domain"),
    fp.Feature("odometry_yaw", "rad", 1e-3,
        "yaw difference between odometry and its transform with the same stamp, 95th percentile, "
        f"maximum {_TOPICS}", "domain"),
    fp.Feature("localisation_position", "m", 5e-3,
        "distance between the pose of localisation and that of the chained transforms, 95th "
        f"percentile, maximum {_TOPICS}", "domain"),
    fp.Feature("localisation_yaw", "rad", 5e-3,
        "yaw difference between localisation and the chained transforms, 95th percentile, "
        f"maximum {_TOPICS}", "domain"),
    fp.Feature("odometry_jump", "m", 5e-3,
        "distance of a pose of odometry from where its two neighbours say that it is, maximum "
        "over the messages and topics", "domain"),
    fp.Feature("odometry_yaw_jump", "rad", 5e-3,
        "yaw difference of a pose of odometry from what its two neighbours say, maximum over the "
        "messages and topics", "domain"),
)  # fmt: skip

_SAME_S = 0.02  # most time between the stamps of a compared pose and transform
_TOGETHER_S = 0.3  # between the times when a pose and a localisation's transform were recorded
_MANY = 0.95  # quantile


class _Apart(NamedTuple):
    """Differences of two sources of one pose, for each message."""

    position: fp.Series  # [m]
    yaw: fp.Series  # [rad]


class _Prepared(NamedTuple):
    """Differences of poses with two sources, by place."""

    odometry: Mapping[str, _Apart]
    localisation: Mapping[str, _Apart]
    jumps: Mapping[str, _Apart]


def _keep_poses(messages: Any) -> tuple[Any, ...]:
    """Return frame, stamp and pose of ``PoseWithCovarianceStamped``s."""
    frames = frame_names(messages.header.frame_id)
    return frames, header_stamps_s(messages), *poses_of(messages.pose.pose)


def prepare(window: fp.Window) -> _Prepared:
    """Compare poses with two sources, over the whole recording."""
    moving = edges(window.topics["transforms"])
    odometry, jumps = {}, {}
    for topic, series in window.topics["odometry"].items():
        stamps, children, *columns = zip(*series.values, strict=True)
        stamps_s, pose = np.array(stamps), PlanarPose.of(*map(np.array, columns))
        if len(stamps_s) > 2:
            jumps[topic] = _jumps(series.times_s, stamps_s, pose)
        for (parent, child), edge in moving.items():
            if child != children[0]:
                continue
            at = nearest(edge.stamps_s, stamps_s)
            near = np.flatnonzero(np.abs(edge.stamps_s[at] - stamps_s) <= _SAME_S)
            odometry[f"{topic} against {parent} -> {child}"] = _apart(
                series.times_s[near], pose.at(near), edge.pose.at(at[near])
            )
    localisation = {
        place: apart
        for topic, series in window.topics["poses"].items()
        for place, apart in _localised(topic, series, moving)
    }
    return _Prepared(odometry, localisation, jumps)


def compute(window: fp.Window) -> fp.Values | fp.Missing:
    """Reduce to the window."""
    prepared: _Prepared = window.prepared
    values = {}
    for name, statements, reason in (
        ("odometry", prepared.odometry, "no odometry with a transform between the same frames"),
        ("localisation", prepared.localisation, "no pose of localisation with its transforms"),
    ):
        for part in ("position", "yaw"):
            sizes = {
                p: quantile(getattr(apart, part), window, _MANY) for p, apart in statements.items()
            }
            values[f"{name}_{part}"] = largest(sizes, reason)
    for name, part in (("odometry_jump", "position"), ("odometry_yaw_jump", "yaw")):
        sizes = {
            p: quantile(getattr(apart, part), window, 1.0) for p, apart in prepared.jumps.items()
        }
        values[name] = largest(sizes, "fewer than three odometry messages")
    return values


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of poses that are both messages and transforms."""
    topics = {
        "odometry": fp.Request(
            keep_odometry, msgtype="nav_msgs/msg/Odometry", dtype=object, optional=True, many=True
        ),
        "poses": fp.Request(
            _keep_poses, msgtype="geometry_msgs/msg/PoseWithCovarianceStamped", dtype=object,
            optional=True, many=True,
        ),
        "transforms": MOVING,
    }  # fmt: skip
    return [
        fp.FeaturePlugin("transforms", "transforms", FEATURES, compute, topics, prepare=prepare)
    ]


def _apart(times_s: Floats, one: PlanarPose, other: PlanarPose) -> _Apart:
    return _Apart(
        fp.Series(times_s, np.abs(one.translation - other.translation)),
        fp.Series(times_s, np.abs(np.angle(one.rotation / other.rotation))),
    )


def _jumps(times_s: Floats, stamps_s: Floats, pose: PlanarPose) -> _Apart:
    """Return the distance of each pose from where its neighbours say that it is at its stamp."""
    shift, yaw = pose.translation, np.unwrap(np.angle(pose.rotation))
    between_s, weight = stamps_s[2:] - stamps_s[:-2], np.full(len(stamps_s) - 2, 0.5)
    np.divide(stamps_s[1:-1] - stamps_s[:-2], between_s, out=weight, where=between_s > 0.0)
    weight = np.clip(weight, 0.0, 1.0)
    place, turn = (np.abs(v[1:-1] - v[:-2] - weight * (v[2:] - v[:-2])) for v in (shift, yaw))
    return _Apart(fp.Series(times_s[1:-1], place), fp.Series(times_s[1:-1], turn))


def _localised(
    topic: str, series: fp.Series, moving: Mapping[tuple[str, str], MovingTransform]
) -> Iterator[tuple[str, _Apart]]:
    """Yield how far poses are from where a transform and the one that hangs on it lead.

    A localisation stamps its transform ahead of time, so the two are matched by when they came. A
    latched pose of before the recording has no transform of its time.
    """
    roots, stamps, *columns = zip(*series.values, strict=True)
    root, stamps_s, believed = roots[0], np.array(stamps), PlanarPose.of(*map(np.array, columns))
    for (parent, middle), upper in moving.items():
        for (hanging, child), lower in moving.items():
            if parent != root or hanging != middle or len(lower.times_s) < 2:
                continue
            order = np.argsort(upper.times_s, kind="stable")
            at = order[nearest(upper.times_s[order], series.times_s)]
            together = np.abs(upper.times_s[at] - series.times_s) <= _TOGETHER_S
            near = np.flatnonzero(together & (stamps_s >= lower.stamps_s.min()))
            hung = PosePath.through(lower.stamps_s, lower.pose).at(stamps_s[near])
            led = upper.pose.at(at[near]).compose(hung)
            place = f"{topic} against {parent} -> {middle} -> {child}"
            yield place, _apart(series.times_s[near], believed.at(near), led)
