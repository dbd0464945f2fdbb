"""Alterations that an attacker could make to a recording, applied while features read it.

An `Alteration` changes or drops each decoded message of the types that it names. No second bag is
written: the altered messages are in memory.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from oracle_pipeline.bags.memory_bag import MemoryBag
from oracle_pipeline.bags.reader import BagReader, RawMessage
from oracle_pipeline.bags.types import serialize
from oracle_pipeline.opened_run import OpenedRun, open_run

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
JOINTS, TRANSFORMS = "sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"

FIVE = 1.05  # 5 % more

#: Takes topic, message and seconds since the onset, and changes the message. False drops it.
Change: TypeAlias = Callable[[str, Any, float], bool | None]


@dataclass(frozen=True)
class Alteration:
    """How a recording is altered.

    Attributes
    ----------
    changes : mapping of str to callable
        By message type: returns a new `Change` for each recording, since it may have a state.
    onset_s : float
        When the alteration begins [s of the recording].
    late_s : mapping of str to float
        By message type: how much later its messages arrive [s].
    """

    changes: Mapping[str, Callable[[], Change]] = field(default_factory=dict)
    onset_s: float = 0.0
    late_s: Mapping[str, float] = field(default_factory=dict)


def pose_of(pose: Any) -> tuple[float, float, float]:
    """Return x [m], y [m] and yaw [rad] of a ``geometry_msgs/msg/Pose``."""
    position, q = pose.position, pose.orientation
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return position.x, position.y, yaw


def open_altered(path: Path, alteration: Alteration, left_out: Collection[str] = ()) -> OpenedRun:
    """Open a run directory as if it had been recorded with an alteration; graphs are left out.

    Raises
    ------
    RuntimeError
        If the alteration changes no message.
    """
    with open_run(path) as run:
        bag = run.bag
        topics = {name: topic for name, topic in bag.topics.items() if name not in left_out}
        original = list(bag.messages(topics))
        altered = list(_altered(bag, original, alteration))
        if altered == original and alteration != Alteration():
            raise RuntimeError(f"{alteration} changes no message of {path}")
        memory = MemoryBag(bag.path, topics, altered, bag.start_ns, bag.end_ns)
        return replace(run, bag=memory, intervals=())


def _altered(
    bag: BagReader, messages: Iterable[RawMessage], alteration: Alteration
) -> Iterator[RawMessage]:
    changes = {each: make() for each, make in alteration.changes.items()}
    for raw in messages:
        msgtype = bag.topics[raw.topic].msgtype
        since_s = (raw.stamp_ns - bag.start_ns) / 1e9 - alteration.onset_s
        data, late_s = raw.data, alteration.late_s.get(msgtype, 0.0)
        if since_s < 0.0:
            yield raw
            continue
        if msgtype in changes:
            message = bag.deserialize(raw)
            if changes[msgtype](raw.topic, message, since_s) is False:
                continue
            data = serialize(message, msgtype)
        yield RawMessage(raw.topic, raw.stamp_ns + round(late_s * 1e9), data)


def ranges_by(function: Callable[[Any], Any]) -> Alteration:
    """Return an alteration that changes the ranges of a scan, from 15 s on."""

    def change(_topic: str, message: Any, _since_s: float) -> None:
        message.ranges = np.asarray(function(message), dtype=np.float32)

    return Alteration({SCAN: lambda: change}, onset_s=15.0)


def replayed(behind: int) -> Alteration:
    """Return an alteration that replaces the ranges of a scan by those of some scans earlier."""

    def make() -> Change:
        past: dict[str, list[Any]] = {}

        def change(topic: str, message: Any, _since_s: float) -> None:
            kept = past.setdefault(topic, [])
            kept.append(message.ranges)
            message.ranges = kept[max(0, len(kept) - 1 - behind)]

        return change

    return Alteration({SCAN: make}, onset_s=10.0)


def frozen() -> Alteration:
    """Return an alteration that repeats the same ranges until the recording ends."""
    return replayed(10**9)


def phantom(ahead_m: float, radius_m: float, noise_m: float) -> Alteration:
    """Return an alteration that adds a cylinder ahead of the robot's pose at the onset.

    The cylinder is fixed in the odometry frame, hides what is behind it, and has sensor noise.
    """

    def make() -> dict[str, Change]:
        state: dict[str, Any] = {"centre": None, "pose": 0j, "yaw": 0.0}
        rng = np.random.default_rng(17)

        def moved(_topic: str, message: Any, _since_s: float) -> None:
            position, q = message.pose.pose.position, message.pose.pose.orientation
            state["pose"] = complex(position.x, position.y)
            state["yaw"] = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))

        def seen(topic: str, message: Any, _since_s: float) -> None:
            mount = {"/scan_tom": 0.116, "/scan_fakeobject": 0.116}.get(topic, -0.064)
            turn = np.exp(1j * state["yaw"])
            if state["centre"] is None:
                state["centre"] = state["pose"] + (ahead_m + mount) * turn
            local = (state["centre"] - state["pose"]) / turn - mount
            bearings = message.angle_min + message.angle_increment * np.arange(len(message.ranges))
            toward = local * np.exp(-1j * bearings)
            beside = np.abs(toward.imag)
            hit = np.full(len(bearings), np.inf)
            met = (beside < radius_m) & (toward.real > 0.0)
            hit[met] = toward.real[met] - np.sqrt(radius_m**2 - beside[met] ** 2)
            hit += noise_m * rng.standard_normal(len(hit))
            message.ranges = np.fmin(hit, message.ranges).astype(np.float32)

        return {ODOMETRY: moved, SCAN: seen}

    made: dict[str, dict[str, Change]] = {}

    def first() -> Change:
        made["now"] = make()
        return made["now"][ODOMETRY]

    return Alteration({ODOMETRY: first, SCAN: lambda: made["now"][SCAN]}, onset_s=10.0)


def without_small_things(message: Any) -> Any:
    """Return the ranges of a scan without the nearest free-standing object."""
    ranges = np.asarray(message.ranges, dtype=np.float64).copy()
    edges = np.flatnonzero(np.abs(np.diff(np.where(np.isfinite(ranges), ranges, 50.0))) > 0.3)
    best, nearest = None, math.inf
    for first, last in pairwise(edges):
        here = ranges[first + 1 : last + 1]
        stands_free = (
            ranges[first] > here[0] and last + 1 < len(ranges) and ranges[last + 1] > here[-1]
        )
        if stands_free and 3 <= len(here) <= 80 and here.min() < nearest:
            best, nearest = (first, last), float(here.min())
    if best is not None:
        first, last = best
        left, right = ranges[first], ranges[last + 1]
        is_finite = math.isfinite(left) and math.isfinite(right)
        background = np.linspace(left, right, last - first + 2)[1:-1] if is_finite else math.inf
        ranges[first + 1 : last + 1] = background
    return ranges


def blinded(message: Any) -> Any:
    """Return the ranges of a scan without returns in a sector of 60 degrees ahead."""
    ranges = np.asarray(message.ranges, dtype=np.float64).copy()
    rays = round(math.radians(30.0) / message.angle_increment)
    ranges[:rays] = ranges[len(ranges) - rays :] = np.inf
    return ranges


def odometry(
    *, along: float = 1.0, turn: float = 1.0, twist: float = 1.0, east_m: float = 0.0,
    aside_m_s: float = 0.0,
) -> Callable[[], Change]:  # fmt: skip
    """Return a change of the poses and twists of odometry, from the first message on."""

    def make() -> Change:
        pose = _pose_change(along, turn, east_m, aside_m_s)

        def change(_topic: str, message: Any, since_s: float) -> None:
            pose(message.pose.pose.position, message.pose.pose.orientation, since_s)
            message.twist.twist.linear.x *= twist
            message.twist.twist.angular.z *= twist if turn == 1.0 else turn

        return change

    return make


def transforms(
    child: str, *, along: float = 1.0, turn: float = 1.0, east_m: float = 0.0,
    aside_m_s: float = 0.0,
) -> Callable[[], Change]:  # fmt: skip
    """Return a change of the transforms to one frame."""

    def make() -> Change:
        pose = _pose_change(along, turn, east_m, aside_m_s)

        def change(_topic: str, message: Any, since_s: float) -> None:
            for each in message.transforms:
                if each.child_frame_id == child:
                    pose(each.transform.translation, each.transform.rotation, since_s)

        return change

    return make


def _pose_change(
    along: float, turn: float, east_m: float, aside_m_s: float
) -> Callable[[Any, Any, float], None]:
    first: list[tuple[complex, float]] = []

    def change(place: Any, rotation: Any, since_s: float) -> None:
        yaw = 2.0 * math.atan2(rotation.z, rotation.w)
        here = complex(place.x, place.y)
        if not first:
            first.append((here, yaw))
        start, start_yaw = first[0]
        sideways = 1j * np.exp(1j * yaw) * aside_m_s * since_s
        moved = start + along * (here - start) + east_m + sideways
        place.x, place.y = moved.real, moved.imag
        if turn != 1.0:
            turned = start_yaw + turn * math.remainder(yaw - start_yaw, 2.0 * math.pi)
            rotation.z, rotation.w = math.sin(turned / 2.0), math.cos(turned / 2.0)

    return change


def scaled(*paths: tuple[str, ...], only: int | None = None) -> Callable[[], Change]:
    """Return a change that makes fields of a message 5 % larger: a whole array, or one element."""

    def change(_topic: str, message: Any, _since_s: float) -> None:
        for *owners, last in paths:
            owner = message
            for name in owners:
                owner = getattr(owner, name)
            value = getattr(owner, last)
            if only is not None:
                value = np.where(np.arange(len(value)) == only, FIVE * value, value)
            else:
                value = FIVE * value
            setattr(owner, last, value)

    return lambda: change


def localisation(east_m: float) -> Callable[[], Change]:
    """Return a change that moves the poses of a localisation."""

    def change(_topic: str, message: Any, _since_s: float) -> None:
        message.pose.pose.position.x += east_m

    return lambda: change


def noisy(message: Any) -> Any:
    """Return the ranges of a scan, each off by up to 2 %."""
    stamp = message.header.stamp
    rng = np.random.default_rng([stamp.sec, stamp.nanosec])
    return message.ranges * (1.0 + 0.02 * rng.uniform(-1.0, 1.0, len(message.ranges)))
