"""From an opened run to its picture, told by the run's own bag and manifest.

The way driven is odometry carried into the map frame by the transforms that the robot published.
Everything is planar, so a point is a complex number [m] and a rotation a complex factor. Drawing is
in ``oracle_pipeline.reporting.scene``.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.reporting.result import ReportError
from oracle_pipeline.reporting.scene import Scene, top_down
from oracle_pipeline.runs import Run

MAP, ODOMETRY, ATTACKED = "/map", "/odom", "/scan_fakeobject"
TRANSFORMS = ("/tf", "/tf_static")


def run_picture(run: Run) -> bytes:
    """Draw a run from above, as PNG; errors are those of `run_scene`."""
    scene, manifest = run_scene(run), _manifest(run)
    return top_down(scene, f"{manifest.mode}|run{manifest.run:03d}, {manifest.outcome}")


def run_scene(run: Run) -> Scene:
    """Read what there is to draw of a run.

    Raises
    ------
    ReportError
        It is a foreign bag, or its bag lacks the map, the odometry or the transform between them.
    BagError
        Its bag cannot be read.
    """
    manifest = _manifest(run)
    story = _Story(manifest, halfway_ns=(run.bag.start_ns + run.bag.end_ns) / 2)
    attacked = {ATTACKED} if manifest.label == "malicious" else set()
    for raw in run.bag.messages({MAP, ODOMETRY, *TRANSFORMS, *attacked}):
        story.hear(raw.topic, raw.stamp_ns, run.bag.deserialize(raw))
    if story.grid is None or not story.way:
        lacking = MAP if story.grid is None else f"{ODOMETRY} or a transform from map to odom"
        raise ReportError(f"{run.path} cannot be drawn: its bag has no {lacking}.")

    info = story.grid.info
    fake = story.fake_object_in_map()
    return Scene(
        occupancy=np.asarray(story.grid.data, dtype=np.int8).reshape(info.height, info.width),
        resolution_m=info.resolution,
        origin=(info.origin.position.x, info.origin.position.y),
        path=_xy(np.array(story.way)),
        start=(manifest.start.x, manifest.start.y),
        goals=np.array([(g.x, g.y, g.yaw) for g in manifest.goals]).reshape(-1, 3),
        disc=None if fake is None else (fake.real, fake.imag, manifest.attack["radius"]),
        scan=None if story.scan is None else _xy(story.scan),
    )


def _manifest(run: Run) -> Manifest:
    if run.manifest is None:
        raise ReportError(
            f"{run.path} was recorded by somebody else and says nothing of goals; "
            "pictures are drawn of run directories."
        )
    return run.manifest


class _Story:
    """What the messages of a run tell, heard in the order in which they were recorded.

    One attacked scan is kept: that from nearest to the fake object or, where there is none, the one
    nearest to halfway through the recording.
    """

    def __init__(self, manifest: Manifest, halfway_ns: float) -> None:
        self.grid: Any = None  # nav_msgs/msg/OccupancyGrid
        self.way: list[complex] = []  # in map
        self.scan: NDArray[np.complex128] | None = None  # in map
        self._frames = _Frames()
        self._halfway_ns = halfway_ns
        self._least = np.inf
        self._attack = manifest.attack

    def hear(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Take one message in."""
        if topic == MAP:
            self.grid = message
        elif topic in TRANSFORMS:
            for heard in message.transforms:
                step = heard.transform
                self._frames.hang(heard, heard.child_frame_id, step.translation, step.rotation)
        elif topic == ODOMETRY:
            pose = message.pose.pose
            self._frames.hang(message, message.child_frame_id, pose.position, pose.orientation)
            if (robot := self._frames.in_map(message.child_frame_id)) is not None:
                self.way.append(robot[0])
        elif self.way:
            self._consider(stamp_ns, message)

    def fake_object_in_map(self) -> complex | None:
        """Return where the fake object is on the map by the newest transform, if there is one."""
        if "radius" not in self._attack:
            return None
        frame = self._frames.in_map(self._attack["frame"])
        return frame and frame[0] + frame[1] * complex(self._attack["x"], self._attack["y"])

    def _consider(self, stamp_ns: int, scan: Any) -> None:
        fake, sensor = self.fake_object_in_map(), self._frames.in_map(scan.header.frame_id)
        off = abs(stamp_ns - self._halfway_ns) if fake is None else abs(self.way[-1] - fake)
        if sensor is not None and off < self._least:
            self._least = off
            ranges = np.asarray(scan.ranges, dtype=np.float64)
            hit = np.flatnonzero(np.isfinite(ranges))
            bearings = scan.angle_min + scan.angle_increment * hit
            self.scan = sensor[0] + sensor[1] * ranges[hit] * np.exp(1j * bearings)


class _Frames:
    """Which frame hangs from which, as last heard."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, complex, complex]] = {}

    def hang(self, stamped: Any, child: str, position: Any, q: Any) -> None:
        """Hang a frame from that of a stamped message."""
        turn = complex(1.0 - 2.0 * (q.y**2 + q.z**2), 2.0 * (q.w * q.z + q.x * q.y))
        parent = stamped.header.frame_id
        self._parents[child] = (parent, complex(position.x, position.y), turn / abs(turn))

    def in_map(self, frame: str) -> tuple[complex, complex] | None:
        """Return where a frame is and how it is turned in the map frame, if that is known."""
        at, turn = 0j, 1 + 0j
        for _ in range(len(self._parents) + 1):
            if frame == "map":
                return at, turn
            if frame not in self._parents:
                return None
            frame, offset, rotation = self._parents[frame]
            at, turn = offset + rotation * at, rotation * turn
        return None  # the frames hang in a ring


def _xy(points: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.column_stack([points.real, points.imag])
