"""Transforms between frames over time: buffer, listener, broadcaster (planar, REP 105 names).

All frames that navigation looks up move in the plane, so a transform is kept as x, y and yaw.
"""

import functools
from typing import Any

import numpy as np

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.arrays import Floats, Ints
from sim.middleware import geometry, qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header, stamp_ns

_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_TFMessage = message_class("tf2_msgs/msg/TFMessage")
_Transform = message_class("geometry_msgs/msg/Transform")
_TransformStamped = message_class("geometry_msgs/msg/TransformStamped")
_Vector3 = message_class("geometry_msgs/msg/Vector3")

CACHE_NS = 10 * SECOND  # tf2's default cache time
_TRIMMED_ABOVE = 1024  # samples; old ones are dropped rarely, as all others have to move
_FRAMES = 32  # for which there is room at first
_LATEST = -(2**63)  # a time that stands for the newest sample of each link
_TF = "tf2_msgs/msg/TFMessage"
_TF_STATIC = qos.profile(100, latched=True)

_PARENT, _COUNT, _STATIC = 0, 1, 2  # columns of the links
_NONE, _UNCONNECTED = -1, -2  # instead of a row


class TransformError(LookupError):
    """A transform is unknown, or unknown at that time."""


class TransformBuffer:
    """The tree of frames, from the transforms received so far.

    A frame has a row in each of three arrays, so that a lookup is one compiled call: its link to
    the parent, the times of the link's samples in order, and the poses in the parent at that time.
    """

    def __init__(self) -> None:
        self._rows: dict[str, int] = {}  # of each frame
        self._links, self._times, self._poses = _arrays(_FRAMES, _TRIMMED_ABOVE + 1)

    def receive(self, message: Any, *, static: bool) -> None:
        """Store the transforms of a ``tf2_msgs/msg/TFMessage``."""
        for stamped in message.transforms:
            child, parent = self._row(stamped.child_frame_id), self._row(stamped.header.frame_id)
            translation, q = stamped.transform.translation, stamped.transform.rotation
            count = _add(
                self._links, self._times, self._poses, child, parent, int(static),
                stamp_ns(stamped.header.stamp), float(translation.x), float(translation.y),
                geometry.quaternion_yaw(q.x, q.y, q.z, q.w),
            )  # fmt: skip
            if count == self._times.shape[1]:
                self._make_room(1, 2)

    def lookup(self, target: str, source: str, time_ns: int | None = None) -> geometry.Pose2D:
        """Return the transform that takes coordinates in ``source`` into ``target``.

        Parameters
        ----------
        target, source
            Frame ids.
        time_ns
            When [ns]; the latest known if omitted.

        Raises
        ------
        TransformError
            If the frames are not connected, or not known at that time.
        """
        above, below = self._row(target), self._row(source)
        at_ns = _LATEST if time_ns is None else time_ns
        (x, y, yaw), unknown = _transform(
            self._links, self._times, self._poses, above, below, at_ns
        )
        if unknown == _NONE:
            return geometry.Pose2D(x, y, yaw)
        if unknown == _UNCONNECTED or time_ns is None:
            raise TransformError(f"frames {target} and {source} are not connected")
        frames, (parent, count, _) = list(self._rows), self._links[unknown].tolist()
        begin, end = self._times[unknown, 0], self._times[unknown, count - 1]
        raise TransformError(
            f"{frames[unknown]} in {frames[parent]} is known from {begin / 1e9:.3f} s "
            f"to {end / 1e9:.3f} s, not at {time_ns / 1e9:.3f} s"
        )

    def _row(self, frame: str) -> int:
        """Return the row of a frame, which may be new."""
        row = self._rows.get(frame)
        if row is None:
            row = self._rows[frame] = len(self._rows)
            if row == len(self._links):
                self._make_room(2, 1)
        return row

    def _make_room(self, frames: int, samples: int) -> None:
        """Multiply the number of rows, and that of the samples in a row."""
        full = self._links, self._times, self._poses
        rows, columns = self._times.shape
        self._links, self._times, self._poses = wide = _arrays(frames * rows, samples * columns)
        for old, new in zip(full, wide, strict=True):
            new[tuple(map(slice, old.shape))] = old


def _arrays(frames: int, samples: int) -> tuple[Ints, Ints, Floats]:
    """Return arrays for so many frames, with so many samples [ns] and [m, m, rad] of each."""
    links = np.tile(np.array([_NONE, 0, False]), (frames, 1))
    return links, np.empty((frames, samples), np.int64), np.empty((frames, samples, 3))


@jit
def _add(
    links: Ints, times: Ints, poses: Floats, child: int, parent: int, static: int,
    time_ns: int, x: float, y: float, yaw: float,
) -> int:  # fmt: skip
    """Add a sample, drop those that are too old, and return how many there are."""
    link, times, poses = links[child], times[child], poses[child]
    if link[_PARENT] != parent:
        link[_PARENT], link[_COUNT], link[_STATIC] = parent, 0, static
    count: int = link[_COUNT] + 1
    index = count - 1
    while index > 0 and times[index - 1] > time_ns:
        _copy(times, poses, index - 1, index)
        index -= 1
    times[index] = time_ns
    poses[index, 0], poses[index, 1], poses[index, 2] = x, y, yaw
    first = 0
    if link[_STATIC]:
        first = count - 1
    elif count > _TRIMMED_ABOVE:
        while times[first] <= times[count - 1] - CACHE_NS:
            first += 1
    if first > 0:
        count -= first
        for i in range(count):
            _copy(times, poses, first + i, i)
    link[_COUNT] = count
    return count


@jit
def _copy(times: Ints, poses: Floats, source: int, target: int) -> None:
    """Copy a sample, number by number: rows take numba some seconds more to compile."""
    times[target] = times[source]
    for axis in range(3):
        poses[target, axis] = poses[source, axis]


@jit
def _transform(
    links: Ints, times: Ints, poses: Floats, target: int, source: int, time_ns: int
) -> tuple[geometry.Planar, int]:
    """Return the pose of the source in the target, and the frame that is unknown, if any."""
    upper, upper_root, unknown = _to_root(links, times, poses, target, time_ns)
    if unknown != _NONE:
        return upper, unknown
    lower, lower_root, unknown = _to_root(links, times, poses, source, time_ns)
    if unknown == _NONE and upper_root != lower_root:
        unknown = _UNCONNECTED
    return geometry.composed(geometry.inverted(upper), lower), unknown


@jit
def _to_root(
    links: Ints, times: Ints, poses: Floats, frame: int, time_ns: int
) -> tuple[geometry.Planar, int, int]:
    """Return a frame's pose in the root above it, the root, and the frame that is unknown."""
    pose = (0.0, 0.0, 0.0)
    for _ in range(len(links)):
        if links[frame, _PARENT] == _NONE:
            return pose, frame, _NONE
        known, above = _at(links[frame], times[frame], poses[frame], time_ns)
        if not known:
            return pose, frame, frame
        pose = geometry.composed(above, pose)
        frame = links[frame, _PARENT]
    return pose, frame, _UNCONNECTED  # the frames form a circle


@jit
def _at(link: Ints, times: Ints, poses: Floats, time_ns: int) -> tuple[bool, geometry.Planar]:
    """Return whether a link is known at a time, and its pose then: between samples, linear."""
    index = last = link[_COUNT] - 1
    if time_ns != _LATEST and not link[_STATIC]:
        while index >= 0 and times[index] > time_ns:
            index -= 1
        if index < 0 or times[last] < time_ns:
            return False, (0.0, 0.0, 0.0)
    x, y, yaw = poses[index]
    if index == last or times[index] == time_ns:
        return True, (x, y, yaw)
    next_x, next_y, next_yaw = poses[index + 1]
    share = (time_ns - times[index]) / (times[index + 1] - times[index])
    turn = share * geometry.wrapped(next_yaw - yaw)
    return True, (x + share * (next_x - x), y + share * (next_y - y), geometry.wrapped(yaw + turn))


class TransformListener(Node):
    """The node that tf2 creates for a listener without one; it fills a buffer.

    Listeners that share a buffer receive the same messages, so only the first of them fills it.
    """

    def __init__(self, domain: Domain, suffix: str, buffer: TransformBuffer | None = None) -> None:
        super().__init__(domain, f"/transform_listener_impl_{suffix}", endpoints="E")
        self.buffer = buffer or TransformBuffer()
        for topic, static, profile in (("/tf", False, qos.TF), ("/tf_static", True, _TF_STATIC)):
            receive = functools.partial(self.buffer.receive, static=static)
            self.create_subscription(_TF, topic, None if buffer else receive, profile)


class TransformBroadcaster:
    """A node's publisher of transforms, on ``/tf`` or ``/tf_static``."""

    def __init__(self, node: Node, *, static: bool = False) -> None:
        topic, profile = ("/tf_static", qos.LATCHED) if static else ("/tf", qos.TF)
        self._publisher = node.create_publisher(_TF, topic, profile)

    def send(self, transforms: list[Any], data: bytes | None = None) -> None:
        """Publish ``geometry_msgs/msg/TransformStamped`` messages together.

        ``data`` are the CDR bytes of the whole, if the caller has them.
        """
        self._publisher.publish(_TFMessage(transforms), data)


def transforms_template(transforms: list[Any]) -> Template:
    """Return a template of a ``tf2_msgs/msg/TFMessage`` with the frames of ``transforms``.

    Of each, the seconds and nanoseconds of the stamp and the seven numbers of the transform differ.
    """
    fields = [
        f"transforms.{index}.{field}"
        for index in range(len(transforms))
        for field in (*STAMP, "transform")
    ]
    return Template(_TFMessage(transforms), _TF, fields)


def planar_transform(
    time_ns: int, parent: str, child: str, pose: geometry.Pose2D, z: float = 0.0
) -> Any:
    """Return a ``TransformStamped`` of a planar pose, ``z`` above the parent [m]."""
    rotation = _Quaternion(*geometry.yaw_quaternion(pose.yaw))
    return _TransformStamped(
        header(time_ns, parent), child, _Transform(_Vector3(pose.x, pose.y, z), rotation)
    )
