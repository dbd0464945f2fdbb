"""The frames in the first message of each topic, read only if types and names are ambiguous."""

import math
from collections.abc import Collection, Iterable
from functools import cached_property
from typing import Any

import numpy as np

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.limits import LARGEST_DECODED
from oracle_pipeline.bags.reader import BagReader

TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_WITH_FRAMES = (
    "nav_msgs/msg/Odometry", "nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)  # fmt: skip


class FirstMessages:
    """Frames of a robot's topics; the bag is read on first use."""

    def __init__(self, bag: BagReader) -> None:
        self.bag = bag

    def frame(self, topic: str) -> str:
        """Return the frame in the header of a topic's first message; empty if there is none."""
        header = getattr(self._first.get(topic), "header", None)
        return _bare(getattr(header, "frame_id", ""))

    def child_frame(self, topic: str) -> str:
        """Return the child frame of an odometry topic."""
        return _bare(getattr(self._first.get(topic), "child_frame_id", ""))

    def pose(self, topic: str) -> tuple[float, float, float] | None:
        """Return x, y [m] and yaw [rad] in a topic's first message; None without a pose."""
        pose = getattr(getattr(self._first.get(topic), "pose", None), "pose", None)
        if pose is None:
            return None
        at, q = pose.position, pose.orientation
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
        return (at.x, at.y, yaw) if math.isfinite(at.x + at.y + yaw) else None

    def frames_of(self, topics: Iterable[str]) -> set[str]:
        """Return the frames of some topics."""
        return {frame for topic in topics if (frame := self.frame(topic))}

    def carried(self, body: str, topics: Iterable[str]) -> int:
        """Return the number of sensors attached to a body, by the first static transforms."""
        return sum(body in self._above(self.frame(topic)) for topic in topics)

    def _above(self, frame: str) -> set[str]:
        above: set[str] = set()
        while frame and frame not in above:  # stops at cycles
            above.add(frame)
            frame = self._parents.get(frame, "")
        return above

    @cached_property
    def _parents(self) -> dict[str, str]:
        return {
            _bare(each.child_frame_id): _bare(each.header.frame_id)
            for topic, message in self._first.items()
            if self.bag.topics[topic].msgtype in TRANSFORM_TYPES and "static" in topic
            for each in message.transforms
        }

    @cached_property
    def _first(self) -> dict[str, Any]:
        wanted = {
            name
            for name, topic in self.bag.topics.items()
            if topic.count and topic.msgtype in (*_WITH_FRAMES, *TRANSFORM_TYPES)
        }
        return _first_messages(self.bag, wanted)


def _first_messages(bag: BagReader, topics: Collection[str]) -> dict[str, Any]:
    """Decode the first message of each topic, in file order; undecodable ones are left out."""
    names = list(bag.topics)
    found: dict[str, Any] = {}
    for batch in bag.batches(topics):
        numbers, rows = np.unique(batch.topics, return_index=True)
        for number, row in zip(numbers.tolist(), rows.tolist(), strict=True):
            name, offset, size = names[number], int(batch.offsets[row]), int(batch.sizes[row])
            if name not in found:
                found[name] = _decoded(bag, name, batch.data[offset : offset + size])
        if len(found) == len(topics):
            break
    return {name: message for name, message in found.items() if message is not None}


def _decoded(bag: BagReader, topic: str, data: bytes) -> Any:
    if len(data) > LARGEST_DECODED:
        return None
    try:
        return bag.decoder(topic)(data)
    except BagError:
        return None


def _bare(frame: object) -> str:
    """Return a frame's name without the leading slash of old drivers."""
    return str(frame).lstrip("/")
