"""The motion of the robot according to each stream of a recording: distance and turn.

Each source of motion becomes a `Motion`: the distance and turn since the beginning, by stamp. Two
tracks are compared by their gains over the same spans, so frames, starting points and earlier drift
do not matter. Sources are found by message type, not by topic name. ``kinematics`` compares the
tracks.
"""

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from oracle_pipeline.features.engine.common_fields import frame_names, header_stamps_s, poses_of
from oracle_pipeline.features.engine.plugin import Request, Series
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.geometry.scan_matching import Steps, along_arc, steps
from oracle_pipeline.features.geometry.scanner_setup import SETUP_TOPICS, ScannerSetup
from oracle_pipeline.features.geometry.scans import SCANS, Floats, Points
from oracle_pipeline.features.geometry.wgs84 import Site, cartesian
from oracle_pipeline.features.statistics.times import even_spans
from oracle_pipeline.robots import roles
from oracle_pipeline.robots.roles import IMU, TRANSFORMS

FramePairs: TypeAlias = tuple[tuple[str, str], ...]  # parent and child of each transform

#: What a source measures, and how: kinds of tracks.
POSE, TWIST, GYRO, ORIENTATION = "pose", "twist", "gyro", "orientation"
JOINTS, SCAN, COMMAND, PLACE = "joints", "scan", "command", "place"
ANGLES, RATES = "angles", "rates"  # of joints: their positions and their velocities

TRAVEL, TURN, SPIN = "travel", "turn", "spin"  # quantities: [m], [rad], and [rad] of joints

SPAN_S = 0.4  # over which gains are compared, unless a source has its own spans
_SLOPE_S = 0.1  # to each side of a time at which a rate is taken
_HELD_S = 0.5  # duration of a command if none follows
_EXPLAINED = 0.9  # share of the motion that joints must explain to be wheels
_SAMPLED_S = 0.05  # between the messages of an inertial unit that are read
_GRAVITY = 9.80665  # [m/s^2]
_AT_ONCE = 2048  # numbers that are multiplied at once
_POSITIONS, _VELOCITIES = 2, 3  # columns of what `_keep_joints` keeps


class Motion(NamedTuple):
    """The motion from one source on one topic; shape (n,) each, stamps ascending."""

    topic: str
    times_s: Floats  # when recorded, since the start of the recording [s]
    stamps_s: Floats  # when measured [s]
    gained: Mapping[str, Points]  # by quantity, from the first stamp on


@dataclass(frozen=True, slots=True)
class MotionSources:
    """All tracks of a recording by kind, and the motion from its scanners."""

    tracks: Mapping[str, Sequence[Motion]]
    steps: Mapping[str, Steps]  # by topic of the scanner
    gravity: Mapping[str, Series]  # length of the accelerations that a unit measured [m/s^2]
    unexplained: Mapping[str, Series]  # accelerations less gravity, in the unit's frame; (n, 3)


def gain(track: Motion, quantity: str, from_s: Floats, to_s: Floats) -> Points:
    """Return the gains of a track over spans; NaN for spans that it does not cover."""
    stamps_s, values = track.stamps_s, track.gained[quantity]
    gained = np.interp(to_s, stamps_s, values) - np.interp(from_s, stamps_s, values)
    covered = (from_s >= stamps_s[0]) & (to_s <= stamps_s[-1])
    return np.where(covered, gained, np.nan)


def slope(track: Motion, quantity: str, from_s: Floats, to_s: Floats) -> Points:
    """Return the derivative of the gains by the time of the spans [1/s]."""
    rates = [
        gain(track, quantity, at_s - _SLOPE_S, at_s + _SLOPE_S) / (2.0 * _SLOPE_S)
        for at_s in (from_s, to_s)
    ]
    return rates[1] - rates[0]


def sources(topics: Mapping[str, Mapping[str, Series]], setup: ScannerSetup) -> MotionSources:
    """Return the sources of motion in the messages on `MOTION_TOPICS`."""
    driven, inertial = topics["driven"], topics["inertial"]
    posed = [_posed(topic, series) for topic, series in _long(driven)]
    posed = posed or list(_transformed(topics["transforms"]))
    places, fixes = list(_places(topics, posed)), list(_fixes(topics["fixes"]))
    poses, *others = [tracks for tracks in (posed, places, fixes) if tracks] or [[]]
    mounts = {
        topic: setup.tree.mount(series.values[0])
        for topic, series in topics["inertial_frames"].items()
    }
    units = [(t, s, m) for t, s in _long(inertial) if (m := mounts[t].pose) is not None]
    gyros = [_gyro(*unit) for unit in units]
    by_position, by_velocity = (
        {
            topic: joints
            for topic, series in _long(topics["joints"])
            if (joints := _joints(series, column)) is not None
        }
        for column in (_POSITIONS, _VELOCITIES)
    )
    tracks: dict[str, list[Motion]] = {
        POSE: poses,
        PLACE: list(itertools.chain(*others)),
        TWIST: [_twisted(topic, series) for topic, series in _long(driven)],
        GYRO: gyros,
        ORIENTATION: [_oriented(*unit) for unit in units if _has_orientation(unit[1])],
        JOINTS: [
            track
            for topic, joints in (by_velocity | by_position).items()
            if (track := wheels(topic, joints, [*poses, *gyros])) is not None
        ],
        ANGLES: [_spun(*each) for each in by_position.items()],
        RATES: [_spun(*each) for each in by_velocity.items()],
        COMMAND: [
            _commanded(topic, series, clock)
            for clock in [*poses, *gyros][:1]
            for topic, series in _long({**topics["commands"], **topics["steered"]})
        ],
    }
    matched = {topic: steps(setup.scanners[topic], mount) for topic, mount in setup.mounts.items()}
    gravity = {
        topic: Series(series.times_s, np.linalg.norm(series.values[:, 8:11], axis=1))
        for topic, series in inertial.items()
    }
    unexplained = {
        topic: Series(series.times_s, series.values[:, 8:11] - _GRAVITY * _up(series, mount))
        for topic, series, mount in units
    }
    matched = {topic: found for topic, found in matched.items() if len(found.to_s)}
    return MotionSources(tracks, matched, gravity, unexplained)


def _keep_driven(messages: Any) -> tuple[Floats, ...]:
    """Return stamp, pose and twist of ``nav_msgs/msg/Odometry``."""
    twist = messages.twist.twist
    return (
        header_stamps_s(messages), *poses_of(messages.pose.pose),
        twist.linear.x, twist.linear.y, twist.angular.z,
    )  # fmt: skip


def _keep_place(messages: Any) -> tuple[Floats, ...]:
    """Return stamp and pose of ``PoseStamped``s."""
    return header_stamps_s(messages), *poses_of(messages.pose)


def _keep_bare_place(messages: Any) -> tuple[Floats, ...]:
    """Return no stamp, and the pose of ``Pose``s."""
    return np.zeros(len(messages)), *poses_of(messages)


def _keep_fix(messages: Any) -> tuple[Floats, ...]:
    """Return stamp, latitude and longitude [deg] of ``NavSatFix``es."""
    return header_stamps_s(messages), messages.latitude, messages.longitude


def _keep_inertial(messages: Any) -> tuple[Floats, ...]:
    """Return stamp, orientation, turn rates, accelerations and a variance of ``Imu``s.

    The variance is the first of the orientation's, -1 if there is no orientation.
    """
    q, w, a = messages.orientation, messages.angular_velocity, messages.linear_acceleration
    return (
        header_stamps_s(messages), q.x, q.y, q.z, q.w, w.x, w.y, w.z, a.x, a.y, a.z,
        messages.orientation_covariance[:, 0],
    )  # fmt: skip


def _keep_frame(message: Any) -> str:
    """Return the frame of a message."""
    return str(message.header.frame_id).lstrip("/")


def _keep_joints(messages: Any) -> tuple[Any, ...]:
    """Return stamp, names, positions and velocities of ``sensor_msgs/msg/JointState``s."""
    return header_stamps_s(messages), messages.name, messages.position, messages.velocity


def keep_transforms(messages: Any) -> tuple[list[FramePairs], list[Floats]]:
    """Return parents and children of the transforms of ``TFMessage``s, and their numbers.

    Numbers are stamp, translation and rotation; a row for each transform of a message.
    """
    each = messages.transforms
    shift, q = each.transform.translation, each.transform.rotation
    numbers = np.column_stack([header_stamps_s(each), shift.x, shift.y, q.x, q.y, q.z, q.w])
    frames = list(
        zip(frame_names(each.header.frame_id), frame_names(each.child_frame_id), strict=True)
    )
    ends = np.searchsorted(each.owners, np.arange(len(messages) + 1)).tolist()
    parts = list(itertools.pairwise(ends))
    shared: dict[FramePairs, FramePairs] = {}  # most messages have the same frames
    names = [tuple(frames[first:after]) for first, after in parts]
    return (
        [shared.setdefault(each, each) for each in names],
        [numbers[first:after] for first, after in parts],
    )


def keep_command(messages: Any) -> tuple[Floats, Floats, Floats]:
    """Return the velocities of ``Twist``s, also of nested ones such as ``TwistStamped``."""
    twist = messages
    while hasattr(twist, "twist"):
        twist = twist.twist
    return twist.linear.x, twist.linear.y, twist.angular.z


def _keep_steered(messages: Any) -> tuple[Floats, Floats, Floats]:
    """Return the velocities of ``AckermannDrive``s, as of a car whose axles are 1 m apart."""
    drive = getattr(messages, "drive", messages)
    return drive.speed, np.zeros(len(messages)), drive.speed * np.tan(drive.steering_angle)


MOVING = Request(keep_transforms, role=TRANSFORMS, dtype=object, optional=True, many=True)
_track = functools.partial(Request, optional=True, many=True)
MOTION_TOPICS = SETUP_TOPICS | {
    "scans": replace(SCANS, optional=True),
    "driven": _track(_keep_driven, msgtype="nav_msgs/msg/Odometry"),
    "places": _track(_keep_place, msgtype="geometry_msgs/msg/PoseStamped"),
    "bare_places": _track(_keep_bare_place, msgtype="geometry_msgs/msg/Pose"),
    "fixes": _track(_keep_fix, msgtype="sensor_msgs/msg/NavSatFix"),
    "inertial": _track(_keep_inertial, role=IMU, every_s=_SAMPLED_S),
    "inertial_frames": Request(_keep_frame, role=IMU, every_s=1e4, dtype=object, optional=True),
    "joints": _track(_keep_joints, role=roles.JOINTS, dtype=object, every_s=_SAMPLED_S),
    "transforms": MOVING,
    "commands": _track(keep_command, msgtype="geometry_msgs/msg/Twist*"),
    "steered": _track(_keep_steered, msgtype="ackermann_msgs/msg/AckermannDrive*"),
}


class MovingTransform(NamedTuple):
    """A transform between two frames over time; shape (n,) each, stamps ascending."""

    times_s: Floats
    stamps_s: Floats
    pose: PlanarPose  # of the child in the parent


def edges(topics: Mapping[str, Series]) -> dict[tuple[str, str], MovingTransform]:
    """Return the transforms of recorded ``TFMessage``s, by parent and child."""
    kept = [each for series in topics.values() for each in series.values]
    if not kept:
        return {}
    names, numbers = zip(*kept, strict=True)
    received_s = np.concatenate([series.times_s for series in topics.values()])
    received_s = np.repeat(received_s, [len(each) for each in numbers])
    columns = np.concatenate(numbers)
    number: dict[tuple[str, str], int] = {}
    of = np.array(
        [number.setdefault(each, len(number)) for frames in names for each in frames], np.int64
    )
    found = {}
    for frames, i in number.items():
        rows = np.flatnonzero(of == i)
        rows = rows[np.argsort(columns[rows, 0], kind="stable")]
        stamps_s, x, y, *q = columns[rows].T
        pose = PlanarPose(x + 1j * y, np.exp(1j * _yaw_of(*q)))
        found[frames] = MovingTransform(received_s[rows], stamps_s, pose)
    return found


def _yaw_of(x: Floats, y: Floats, z: Floats, w: Floats) -> Floats:
    """Return the yaw of quaternions [rad]."""
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


class _Joints(NamedTuple):
    """The angles of the joints of one topic; stamps ascending."""

    times_s: Floats  # when recorded, since the start of the recording [s]; shape (n,)
    stamps_s: Floats  # when measured [s]; shape (n,)
    angles: Floats  # [rad]; shape (n, joints)


def wheels(topic: str, joints: _Joints, references: Sequence[Motion]) -> Motion | None:
    """Return the motion that joints measure, in radians of a wheel; None if they measure none.

    The joints that are wheels, and their directions, are those that best explain the motion from
    another source; their radius is left to the comparison. The weights of all joints sum to one in
    magnitude, so that the result is the angle of one wheel if all turn equally.
    """
    times_s, at_s, angles = joints
    from_s, to_s = even_spans(at_s[0], at_s[-1], SPAN_S, at_s)
    turned = np.column_stack(
        [np.interp(to_s, at_s, a) - np.interp(from_s, at_s, a) for a in angles.T]
    )
    gained: dict[str, Points] = {}
    for track in references:
        for quantity in sorted(track.gained.keys() - gained.keys()):
            gains = gain(track, quantity, from_s, to_s).real
            direction = _explaining(turned, gains)
            if direction is not None:
                gained[quantity] = _complex(_weighted(angles, direction))
    return Motion(topic, times_s, at_s, gained) if gained else None


def _joints(series: Series, column: int) -> _Joints | None:
    """Return the angles of joints from their positions, or from their integrated velocities.

    Of several publishers, such as wheels and a gripper, the one with most joints counts. None if
    its messages lack them for any joint.
    """
    rows = series.values
    names = max((row[1] for row in rows), key=len)
    whole = np.array([row[1] == names and len(row[column]) == len(names) for row in rows])
    if not names or whole.sum() < 2:
        return None
    stamps_s = np.array([row[0] for row in rows])
    order = np.flatnonzero(whole)[np.argsort(stamps_s[whole], kind="stable")]
    values = np.stack([np.asarray(rows[i][column], dtype=np.float64) for i in order])
    at_s = stamps_s[order]
    angles = _unwrapped(values) if column == _POSITIONS else _summed(at_s, values)
    return _Joints(series.times_s[order], at_s, angles)


def _unwrapped(angles: Floats) -> Floats:
    """Return angles of joints without jumps of a turn.

    What exceeds a turn counts turns itself. To unwrap it would take half a turn between two
    messages for one back, as after a stall.
    """
    is_wrapped = np.abs(angles).max(axis=0) <= 2.0 * np.pi
    return np.where(is_wrapped, np.unwrap(angles, axis=0), angles)


def _spun(topic: str, joints: _Joints) -> Motion:
    """Return two sums of the angles of all joints, the second with alternating signs.

    No change of joints cancels in both.
    """
    signs = 1.0 + 1j * (-1.0) ** np.arange(joints.angles.shape[1])
    return Motion(topic, joints.times_s, joints.stamps_s, {SPIN: _weighted(joints.angles, signs)})


def _weighted(rows: Floats, weights: Any) -> Any:
    """Return ``rows @ weights``, some rows at a time.

    A large product wakes the threads of the linear algebra library, which then wait for more in a
    busy loop.
    """
    step = max(1, _AT_ONCE // rows.shape[1])
    firsts = range(0, max(1, len(rows)), step)
    return np.concatenate([rows[first : first + step] @ weights for first in firsts])


def _explaining(turned: Floats, gains: Floats) -> Floats | None:
    """Return the weights of joints that explain some gains, in sum 1; None if they cannot."""
    known = np.isfinite(gains) & np.isfinite(turned).all(axis=1)
    power = float((gains[known] ** 2).sum())
    if known.sum() < 2 * turned.shape[1] or power < 1e-3:
        return None
    weights = np.asarray(np.linalg.lstsq(turned[known], gains[known], rcond=0.02)[0], np.float64)
    left = float(((_weighted(turned[known], weights) - gains[known]) ** 2).sum())
    size = float(np.abs(weights).sum())
    told = left < (1.0 - _EXPLAINED) * power and size > 0.0
    return np.asarray(weights / size, np.float64) if told else None


def _long(topics: Mapping[str, Series]) -> Iterator[tuple[str, Series]]:
    """Yield the topics with at least two messages."""
    return ((topic, series) for topic, series in topics.items() if len(series.times_s) > 1)


def _posed(topic: str, series: Series) -> Motion:
    rows = np.argsort(series.values[:, 0], kind="stable")
    stamps_s, x, y, yaw = series.values[rows, :4].T
    return _of_poses(topic, series.times_s[rows], stamps_s, x + 1j * y, np.unwrap(yaw))


def _places(
    topics: Mapping[str, Mapping[str, Series]], clocks: Sequence[Motion]
) -> Iterator[Motion]:
    """Yield the motion by published poses; those that are rare are goals, perhaps.

    Poses without stamps get those of a clock's track.
    """
    for topic, (times_s, values) in _known({**topics["places"], **topics["bare_places"]}):
        if float(np.median(np.diff(times_s))) > SPAN_S:
            continue
        stamps_s = values[:, 0]
        if not (np.diff(stamps_s) > 0.0).any():
            stamps_s = times_s
            if clocks:
                stamps_s = np.interp(times_s, clocks[0].times_s, clocks[0].stamps_s)
        rows = np.argsort(stamps_s, kind="stable")
        _, x, y, yaw = values[rows].T
        yield _of_poses(topic, times_s[rows], stamps_s[rows], x + 1j * y, np.unwrap(yaw))


def _fixes(topics: Mapping[str, Series]) -> Iterator[Motion]:
    """Yield the distance by satellites, which tell no heading."""
    for topic, (times_s, values) in _known(topics):
        rows = np.argsort(values[:, 0], kind="stable")
        stamps_s, latitude, longitude = values[rows].T
        place, _ = Site(latitude[0], longitude[0]).seen(cartesian(latitude, longitude, 0.0))
        along = np.cumsum(np.abs(np.diff(place, prepend=place[:1])))
        yield Motion(topic, times_s[rows], stamps_s, {TRAVEL: _complex(along)})


def _known(topics: Mapping[str, Series]) -> Iterator[tuple[str, Series]]:
    """Yield the messages with a place, of topics with at least two."""
    for topic, (times_s, values) in topics.items():
        finite = np.isfinite(values).all(axis=1)
        if finite.sum() > 1:
            yield topic, Series(times_s[finite], values[finite])


def _of_poses(topic: str, times_s: Floats, stamps_s: Floats, place: Points, yaw: Floats) -> Motion:
    step, turn = np.diff(place), np.diff(yaw)
    along = np.concatenate([[0.0], np.cumsum(step * np.exp(-1j * yaw[:-1]) * along_arc(turn))])
    return Motion(topic, times_s, stamps_s, {TRAVEL: _complex(along), TURN: _complex(yaw)})


def _transformed(topics: Mapping[str, Series]) -> Iterator[Motion]:
    """Yield the motion of the moving transform with most messages, if there is one."""
    moving = {
        frames: edge
        for frames, edge in edges(topics).items()
        if len(edge.times_s) > 1 and np.abs(np.diff(edge.pose.translation)).max() > 0.0
    }
    if moving:
        parent, child = max(moving, key=lambda frames: len(moving[frames].times_s))
        times_s, stamps_s, pose = moving[parent, child]
        yaw = np.unwrap(np.angle(pose.rotation))
        yield _of_poses(f"{parent} -> {child}", times_s, stamps_s, pose.translation, yaw)


def _twisted(topic: str, series: Series) -> Motion:
    rows = np.argsort(series.values[:, 0], kind="stable")
    stamps_s, *_, ahead, aside, rate = series.values[rows].T
    speed = ahead + 1j * aside
    return Motion(
        topic, series.times_s[rows], stamps_s,
        {TRAVEL: _summed(stamps_s, speed), TURN: _complex(_summed(stamps_s, rate))},
    )  # fmt: skip


def _gyro(topic: str, series: Series, mount: PlanarPose) -> Motion:
    stamps_s, values = _by_stamp(series)
    rate = -values[:, 7] if mount.mirrored else values[:, 7]
    return Motion(topic, series.times_s, stamps_s, {TURN: _complex(_summed(stamps_s, rate))})


def _has_orientation(series: Series) -> bool:
    q, variance = series.values[:, 1:5], series.values[0, 11]
    return bool(variance != -1.0 and np.ptp(q, axis=0).max() > 0.0)


def _up(series: Series, mount: PlanarPose) -> Floats:
    """Return the vertical in a unit's frame, shape (n, 3); from its mount without orientation."""
    x, y, z, w = series.values[:, 1:5].T
    up = 2.0 * np.column_stack([x * z - w * y, y * z + w * x, 0.5 - x * x - y * y])
    told = (series.values[:, 11] != -1.0) & (x * x + y * y + z * z + w * w > 0.5)
    level = np.array([0.0, 0.0, -1.0 if mount.mirrored else 1.0])
    return np.where(told[:, None], up, level)


def _oriented(topic: str, series: Series, mount: PlanarPose) -> Motion:
    stamps_s, values = _by_stamp(series)
    yaw = np.unwrap(_yaw_of(*values[:, 1:5].T))
    return Motion(
        topic, series.times_s, stamps_s, {TURN: _complex(-yaw if mount.mirrored else yaw)}
    )


def _commanded(topic: str, series: Series, clock: Motion) -> Motion:
    """Return the gains if each command were executed until the next one.

    A ``Twist`` has no stamp; it gets the one that the clock's track has at the recorded time.
    """
    stamps_s = np.interp(series.times_s, clock.times_s, clock.stamps_s)
    held_s = np.minimum(np.append(np.diff(stamps_s), _HELD_S), _HELD_S)
    knots_s = np.column_stack([stamps_s, stamps_s + held_s]).ravel()
    gained = {}
    for quantity, rate in (
        (TRAVEL, series.values[:, 0] + 1j * series.values[:, 1]),
        (TURN, series.values[:, 2] + 0j),
    ):
        after = np.cumsum(rate * held_s)
        gained[quantity] = np.column_stack([np.append(0.0, after[:-1]), after]).ravel()
    return Motion(topic, np.repeat(series.times_s, 2), knots_s, gained)


def _complex(values: Any) -> Points:
    """Return numbers as complex ones; those of turns have no imaginary part."""
    return np.asarray(values, dtype=np.complex128)


def _by_stamp(series: Series) -> tuple[Floats, Floats]:
    values = series.values[np.argsort(series.values[:, 0], kind="stable")]
    return values[:, 0], values


def _summed(stamps_s: Floats, rate: Any) -> Any:
    """Return the integral of a rate up to each stamp, by trapezoids."""
    rate_t = rate.T
    steps = np.diff(stamps_s) * 0.5 * (rate_t[..., 1:] + rate_t[..., :-1])
    zero = np.zeros((*rate_t.shape[:-1], 1))
    return np.concatenate([zero, np.cumsum(steps, axis=-1)], axis=-1).T
