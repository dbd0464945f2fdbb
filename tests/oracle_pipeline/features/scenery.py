"""A robot with laser scanners in a square room with discs, as messages of a recording."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from oracle_pipeline import features
from oracle_pipeline.bags.types import message_class
from oracle_pipeline.features.engine.plugin import FeaturePlugin
from oracle_pipeline.features.manager import FeatureManager
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.features.conftest import write_bag

ROOM_M = 2.0  # from the middle to each wall
RAYS = 360
RANGE_MAX_M = 10.0


@dataclass(frozen=True)
class World:
    """Surroundings of a scanner: walls, and discs as (x, y, radius) [m]."""

    discs: tuple[tuple[float, float, float], ...] = ()
    room_m: float = ROOM_M

    def cast(self, origin: complex, bearings: np.ndarray) -> np.ndarray:
        """Distance from a place to the first surface in each direction."""
        ray = np.exp(1j * bearings)
        with np.errstate(divide="ignore", over="ignore"):
            walls = [
                (side * self.room_m - start) / step
                for start, step in ((origin.real, ray.real), (origin.imag, ray.imag))
                for side in (-1.0, 1.0)
            ]
        nearest = np.min(np.where(np.array(walls) > 1e-12, walls, np.inf), axis=0)
        for x, y, radius in self.discs:
            to_centre = complex(x, y) - origin
            along = (to_centre * ray.conj()).real
            beside = np.abs((to_centre * ray.conj()).imag)
            chord = np.sqrt(np.maximum(radius**2 - beside**2, 0.0))
            nearest = np.where((beside < radius) & (along > 0), along - chord, nearest)
        return nearest


@dataclass(frozen=True)
class Scanner:
    """A scanner ahead of the robot's base by ``x_m``; optionally upside down."""

    topic: str
    x_m: float = 0.0
    world: World = field(default_factory=World)
    noise: float = 0.0  # uniform, a share of the range
    late_s: float = 0.0  # after full fifths of a second
    upside_down: bool = False


Pose = tuple[complex, float]


def extract(
    plugins: Sequence[FeaturePlugin], recorded: list[tuple[float, str, Any]], folder: Path
) -> tuple[dict[str, float], dict[str, str], dict[str, str]]:
    """Values of a recording, where they are, and what is missing; without the family's name."""
    write_bag(folder / "robot", recorded)
    return of_bag(plugins, folder / "robot")


def of_bag(
    plugins: Sequence[FeaturePlugin], path: Path
) -> tuple[dict[str, float], dict[str, str], dict[str, str]]:
    """Values of a bag, where they are, and what is missing; without the family's name."""
    with open_run(path) as run:
        table = features.extract(run, FeatureManager(tuple(plugins))).run
    row = table.iloc[0].to_dict()
    values = {name: value for name, value in row.items() if "." in name}
    columns = values, json.loads(row["where"]), json.loads(row["missing"])
    return tuple({name.partition(".")[2]: each for name, each in c.items()} for c in columns)


def still(_time_s: float) -> Pose:
    return 0j, 0.0


def turning(time_s: float) -> Pose:
    return 0j, time_s


def driving(time_s: float) -> Pose:
    return complex(0.2 * time_s - 1.0, 0.0), 0.3 * np.sin(time_s)


def recording(
    scanners: Sequence[Scanner],
    motion: Callable[[float], Pose] = still,
    seconds: float = 6.0,
    *,
    odometry: bool = True,
    seed: int = 0,
) -> list[tuple[float, str, Any]]:
    """Messages of scanners at 5 Hz, odometry at 20 Hz and the static transforms."""
    rng = np.random.default_rng(seed)
    recorded: list[tuple[float, str, Any]] = [(0.0, "/tf_static", mounts(scanners))]
    recorded += [
        (step / 20, "/odom", odometry_message(step / 20, *motion(step / 20)))
        for step in range(round(seconds * 20) if odometry else 0)
    ]
    for scanner in scanners:
        for step in range(round(seconds * 5)):
            time_s = step / 5 + scanner.late_s
            recorded.append((time_s, scanner.topic, look(scanner, time_s, motion(time_s), rng)))
    return sorted(recorded, key=lambda each: each[0])


def look(scanner: Scanner, time_s: float, base: Pose, rng: np.random.Generator) -> Any:
    """One scan from where the scanner is."""
    place, yaw = base
    bearings = np.arange(RAYS) * 2.0 * np.pi / RAYS
    directions = yaw + (-bearings if scanner.upside_down else bearings)
    ranges = scanner.world.cast(place + scanner.x_m * np.exp(1j * yaw), directions)
    ranges *= 1.0 + scanner.noise * rng.uniform(-1.0, 1.0, RAYS)
    return scan_message(time_s, frame_of(scanner.topic), ranges)


def frame_of(topic: str) -> str:
    return f"frame_of{topic.replace('/', '_')}"


def header(seconds: float, frame: str) -> Any:
    whole = int(seconds)
    stamp = message_class("builtin_interfaces/msg/Time")(whole, round((seconds - whole) * 1e9))
    return message_class("std_msgs/msg/Header")(stamp, frame)


def scan_message(seconds: float, frame: str, ranges: Any) -> Any:
    increment = 2.0 * np.pi / max(1, len(ranges))
    return message_class("sensor_msgs/msg/LaserScan")(
        header(seconds, frame), 0.0, 2.0 * np.pi - increment, increment, 0.0, 0.0, 0.05,
        RANGE_MAX_M, np.asarray(ranges, dtype=np.float32), np.zeros(0, dtype=np.float32),
    )  # fmt: skip


def range_message(seconds: float, frame: str, measured: float) -> Any:
    return message_class("sensor_msgs/msg/Range")(
        header(seconds, frame), 1, 0.2, 0.05, 1.8, measured
    )


def quaternion(yaw: float, *, upside_down: bool = False) -> Any:
    turn = message_class("geometry_msgs/msg/Quaternion")
    half = (float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
    return turn(half[1], half[0], 0.0, 0.0) if upside_down else turn(0.0, 0.0, *half)


def pose_message(place: complex, yaw: float) -> Any:
    point = message_class("geometry_msgs/msg/Point")(place.real, place.imag, 0.0)
    return message_class("geometry_msgs/msg/Pose")(point, quaternion(yaw))


def odometry_message(seconds: float, place: complex, yaw: float) -> Any:
    vector = message_class("geometry_msgs/msg/Vector3")(0.0, 0.0, 0.0)
    twist = message_class("geometry_msgs/msg/Twist")(vector, vector)
    covariance = np.zeros(36)
    posed = message_class("geometry_msgs/msg/PoseWithCovariance")
    return message_class("nav_msgs/msg/Odometry")(
        header(seconds, "odom"), "base", posed(pose_message(place, yaw), covariance),
        message_class("geometry_msgs/msg/TwistWithCovariance")(twist, covariance),
    )  # fmt: skip


def believed_message(
    seconds: float, place: complex, yaw: float, position_sd: float = 0.0, yaw_sd: float = 0.0
) -> Any:
    covariance = np.zeros(36)
    covariance[[0, 7]], covariance[35] = position_sd**2 / 2.0, yaw_sd**2
    posed = message_class("geometry_msgs/msg/PoseWithCovariance")
    return message_class("geometry_msgs/msg/PoseWithCovarianceStamped")(
        header(seconds, "map"), posed(pose_message(place, yaw), covariance)
    )


def mounts(scanners: Sequence[Scanner]) -> Any:
    return transforms(
        *(("base", frame_of(s.topic), s.x_m, s.upside_down) for s in scanners),
        ("base", "nose", 0.1, False),
    )


def transforms(*joints: tuple[str, str, float, bool]) -> Any:
    """Parent, child, x [m] and whether it hangs upside down."""
    vector = message_class("geometry_msgs/msg/Vector3")
    transform = message_class("geometry_msgs/msg/Transform")
    stamped = message_class("geometry_msgs/msg/TransformStamped")
    return message_class("tf2_msgs/msg/TFMessage")(
        [
            stamped(
                header(0.0, parent), child,
                transform(vector(x_m, 0.0, 0.0), quaternion(0.0, upside_down=down)),
            )
            for parent, child, x_m, down in joints
        ]
    )  # fmt: skip


def grid_message(seconds: float, cells: Any, resolution: float, corner: complex) -> Any:
    cells = np.asarray(cells, dtype=np.int8)
    rows, columns = cells.shape
    stamp = message_class("builtin_interfaces/msg/Time")(0, 0)
    info = message_class("nav_msgs/msg/MapMetaData")(
        stamp, resolution, columns, rows, pose_message(corner, 0.0)
    )
    return message_class("nav_msgs/msg/OccupancyGrid")(header(seconds, "map"), info, cells.ravel())
