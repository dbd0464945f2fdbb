"""Transforms between frames over time: buffer, listener, broadcaster (planar, REP 105 names).

All frames that navigation looks up move in the plane, so a transform is kept as x, y and yaw.
"""

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND
from sim.middleware.geometry import Pose2D, quaternion_yaw, wrap_angle, yaw_quaternion
from sim.middleware.node import Node
from sim.middleware.stamps import header, stamp_ns

_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_TFMessage = message_class("tf2_msgs/msg/TFMessage")
_Transform = message_class("geometry_msgs/msg/Transform")
_TransformStamped = message_class("geometry_msgs/msg/TransformStamped")
_Vector3 = message_class("geometry_msgs/msg/Vector3")

_Planar = tuple[float, float, float]  # x, y [m], yaw [rad]

CACHE_NS = 10 * SECOND  # tf2's default cache time
_TF = "tf2_msgs/msg/TFMessage"
_TF_STATIC_QOS = qos.profile(100, latched=True)


class TransformError(LookupError):
    """A transform is unknown, or unknown at that time."""


@dataclass(slots=True)
class _Link:
    """The poses of a child frame in its parent over the last ten seconds."""

    parent: str
    static: bool
    times: list[int] = field(default_factory=list)
    poses: list[_Planar] = field(default_factory=list)

    def add(self, time_ns: int, pose: _Planar) -> None:
        if not self.times or time_ns >= self.times[-1]:
            self.times.append(time_ns)
            self.poses.append(pose)
        else:
            index = bisect_right(self.times, time_ns)
            self.times.insert(index, time_ns)
            self.poses.insert(index, pose)
        if len(self.times) > 1024 or self.static:  # trimmed rarely, as deleting takes linear time
            keep = bisect_right(self.times, self.times[-1] - CACHE_NS) if not self.static else -1
            del self.times[:keep], self.poses[:keep]

    def at(self, time_ns: int | None, child: str) -> _Planar:
        if self.static or time_ns is None:
            return self.poses[-1]
        index = bisect_right(self.times, time_ns)
        if index == 0 or (index == len(self.times) and time_ns > self.times[-1]):
            raise TransformError(
                f"{child} in {self.parent} is known from {self.times[0] / 1e9:.3f} s "
                f"to {self.times[-1] / 1e9:.3f} s, not at {time_ns / 1e9:.3f} s"
            )
        before = self.poses[index - 1]
        if self.times[index - 1] == time_ns:
            return before
        after = self.poses[index]
        share = (time_ns - self.times[index - 1]) / (self.times[index] - self.times[index - 1])
        return (
            before[0] + share * (after[0] - before[0]),
            before[1] + share * (after[1] - before[1]),
            wrap_angle(before[2] + share * wrap_angle(after[2] - before[2])),
        )


class TransformBuffer:
    """The tree of frames, from the transforms received so far."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}

    def receive(self, message: Any, *, static: bool) -> None:
        """Store the transforms of a ``tf2_msgs/msg/TFMessage``."""
        for stamped in message.transforms:
            child = stamped.child_frame_id
            link = self._links.get(child)
            if link is None or link.parent != stamped.header.frame_id:
                link = self._links[child] = _Link(stamped.header.frame_id, static)
            translation, q = stamped.transform.translation, stamped.transform.rotation
            yaw = quaternion_yaw(q.x, q.y, q.z, q.w)
            link.add(stamp_ns(stamped.header.stamp), (translation.x, translation.y, yaw))

    def lookup(self, target: str, source: str, time_ns: int | None = None) -> Pose2D:
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
        root_target, to_x, to_y, to_yaw = self._to_root(target, time_ns)
        root_source, x, y, yaw = self._to_root(source, time_ns)
        if root_target != root_source:
            raise TransformError(f"frames {target} and {source} are not connected")
        # The target's inverse, and the source in it: `Pose2D.inverse`, `Pose2D.compose`.
        c, s = math.cos(to_yaw), math.sin(to_yaw)
        to_x, to_y, to_yaw = -c * to_x - s * to_y, s * to_x - c * to_y, wrap_angle(-to_yaw)
        c, s = math.cos(to_yaw), math.sin(to_yaw)
        return Pose2D(to_x + c * x - s * y, to_y + s * x + c * y, wrap_angle(to_yaw + yaw))

    def latest_common_ns(self, target: str, source: str) -> int:
        """Return the newest time at which ``lookup(target, source)`` is known [ns]."""
        self.lookup(target, source)
        newest = [
            self._links[frame].times[-1]
            for end in (target, source)
            for frame in self._ancestors(end)
            if frame in self._links and not self._links[frame].static
        ]
        return min(newest, default=0)

    def _ancestors(self, frame: str) -> Iterable[str]:
        yield frame
        while frame in self._links:
            frame = self._links[frame].parent
            yield frame

    def _to_root(self, frame: str, time_ns: int | None) -> tuple[str, float, float, float]:
        """Return the root above a frame, and the frame's pose in it.

        Composed as by `Pose2D.compose`, but without a pose for each link: it is called often.
        """
        links = self._links
        x = y = yaw = 0.0
        while (link := links.get(frame)) is not None:
            link_x, link_y, link_yaw = link.at(time_ns, frame)
            c, s = math.cos(link_yaw), math.sin(link_yaw)
            x, y = link_x + c * x - s * y, link_y + s * x + c * y
            yaw = wrap_angle(link_yaw + yaw)
            frame = link.parent
        return frame, x, y, yaw


class TransformListener(Node):
    """The node that tf2 creates for a listener without one; it fills a buffer.

    Listeners that share a buffer receive the same messages, so only the first of them fills it.
    """

    def __init__(self, domain: Domain, suffix: str, buffer: TransformBuffer | None = None) -> None:
        super().__init__(domain, f"/transform_listener_impl_{suffix}", endpoints="E")
        feed = buffer is None
        self.buffer = TransformBuffer() if buffer is None else buffer
        self.create_subscription(_TF, "/tf", self._on_tf if feed else None, qos.TF)
        self.create_subscription(
            _TF, "/tf_static", self._on_tf_static if feed else None, _TF_STATIC_QOS
        )

    def _on_tf(self, message: Any) -> None:
        self.buffer.receive(message, static=False)

    def _on_tf_static(self, message: Any) -> None:
        self.buffer.receive(message, static=True)


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


def planar_transform(time_ns: int, parent: str, child: str, pose: Pose2D, z: float = 0.0) -> Any:
    """Return a ``TransformStamped`` of a planar pose, ``z`` above the parent [m]."""
    rotation = _Quaternion(*yaw_quaternion(pose.yaw))
    return _TransformStamped(
        header(time_ns, parent), child, _Transform(_Vector3(pose.x, pose.y, z), rotation)
    )
