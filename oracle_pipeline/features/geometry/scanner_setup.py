"""The laser scanners of a robot: their scans, where they are mounted, and how the robot moved."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from oracle_pipeline.features.engine.plugin import Series, Window, sole_series
from oracle_pipeline.features.geometry.odometry_path import ODOMETRY_POSES, OdometryPath
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.geometry.scans import SCANS, Floats, RecordedScans
from oracle_pipeline.features.geometry.transform_tree import (
    STATIC_FRAMES,
    SensorMount,
    TransformTree,
)

_MOST_SCANNERS = 24  # of one robot; each is compared with every other one

SETUP_TOPICS = {
    "scans": SCANS,
    "odometry": replace(ODOMETRY_POSES, optional=True),
    "frames": STATIC_FRAMES,
}


@dataclass(frozen=True, slots=True)
class ScannerSetup:
    """The scanners of a robot, their mounts, and the robot's motion."""

    scanners: Mapping[str, RecordedScans]  # by topic
    mounts: Mapping[str, SensorMount]  # of those that are level and have bearings
    tree: TransformTree
    motion: OdometryPath | None

    def poses(self, mount: SensorMount, stamps_s: Floats) -> PlanarPose:
        """Return the poses of a sensor in the odometry frame, or on the robot without odometry."""
        if self.motion is not None:
            return self.motion.at(mount, stamps_s)
        count = len(stamps_s)
        on_robot = PlanarPose(np.zeros(count, np.complex128), np.ones(count, np.complex128))
        return on_robot if mount.pose is None else on_robot.compose(mount.pose)


def scanner_setup(window: Window) -> ScannerSetup:
    """Return the setup from the messages on `SETUP_TOPICS`, computed once for all plugins."""
    used = {name: window.topics[name] for name in SETUP_TOPICS}
    key = tuple(
        (name, topic, id(series.values))
        for name, topics in used.items()
        for topic, series in topics.items()
    )
    if key not in window.shared:
        window.shared[key] = _setup(used), used  # what is kept keeps its identity
    setup: ScannerSetup = window.shared[key][0]
    return setup


def _setup(topics: Mapping[str, Mapping[str, Series]]) -> ScannerSetup:
    tree = TransformTree(topics["frames"])
    used = sorted(topics["scans"].items())[:_MOST_SCANNERS]
    scanners = {topic: RecordedScans(series) for topic, series in used}
    mounts = {topic: tree.mount(scans.frame) for topic, scans in scanners.items()}
    odometry = sole_series(topics["odometry"])
    return ScannerSetup(
        scanners,
        {
            topic: mount
            for topic, mount in mounts.items()
            if mount.pose is not None and scanners[topic].have_bearings()
        },
        tree,
        None if odometry is None else OdometryPath(odometry, tree),
    )
