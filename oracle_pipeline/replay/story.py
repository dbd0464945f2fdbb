"""From an opened run to its scene, in one pass over its bag and manifest.

Topics are found by role, as for features. The driven path is that of the robot's base, from
transforms and odometry, in the root frame: map, or odom if nothing localized the robot. Everything
is planar, so a point is a complex number [m] and a rotation a complex factor. Drawing is in
``oracle_pipeline.replay.scene``.
"""

import cmath
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.features.point_clouds import sliced
from oracle_pipeline.opened_run import OpenedRun
from oracle_pipeline.replay.scene import DrawnGrid, Moment, ReplayScene
from oracle_pipeline.reporting.report import ReportError
from oracle_pipeline.robots.robot import find_robots
from oracle_pipeline.robots.roles import (
    BEHAVIOR_TREE,
    LOCAL_COSTMAP,
    MAP,
    ODOMETRY,
    PLAN,
    SCAN,
    STATIC_TRANSFORMS,
    TRANSFORMS,
    Roles,
)

MOST_MOMENTS = 20_000  # of a film
FARTHEST_M = 1e8
LONGEST_PAUSE_NS = 60_000_000_000  # without a message, of those that are shown
MAP_FRAME = "map"  # REP 105; recipes are drawn in it
ATTACKED = "/scan_fakeobject"  # of simulated runs
BASES = ("base_footprint", "base_link")  # REP 105 and 120
RECOVERY = "RecoveryActions"  # what Nav2's behaviour trees call the node above their recoveries
LEAST_STEP_M = 0.01  # between two points of the way; finer does not show

_Points = NDArray[np.complex128]
_Placed = tuple[complex, complex]  # where something is, and how it is turned
_NO_POINTS: _Points = np.zeros(0, dtype=np.complex128)


def run_scene(run: OpenedRun, moments_per_s: float | None = None) -> ReplayScene:
    """Read the scene of a run, or of a foreign bag; of several robots, that of the first.

    Parameters
    ----------
    run : Run
        Map, goals and attack are in the scene as far as bag and manifest have them.
    moments_per_s : float, optional
        How many moments the scene has for a second of the recording; by default it has none.

    Raises
    ------
    ReportError
        The bag lacks the robot's pose, or its pose on the recorded map.
    BagError
        The bag cannot be read.
    """
    robot = find_robots(run.bag)[0]
    run = replace(run, bag=robot.bag)
    story = _Story(run, robot.roles, moments_per_s)
    for raw in run.bag.messages(story.topics):
        story.hear(raw.topic, raw.stamp_ns, run.bag.deserialize(raw))
    return story.scene()


class _Story:
    """The state of a run, updated by its messages in the order of recording.

    Of the attacked scans that from nearest to the fake object is kept or, where there is none, the
    one nearest to halfway through the recording; of a run without an attack, the plain scan there.
    """

    def __init__(self, run: OpenedRun, roles: Roles, moments_per_s: float | None) -> None:
        self._run = run
        attacked = run.manifest if run.manifest and run.manifest.label == "malicious" else None
        self._attack = attacked.attack if attacked else {}
        self._onset_s = attacked.onset_s if attacked else None
        self._has_odometry = bool(roles.found[ODOMETRY].topics)
        self._now_ns = 0  # since the start of the recording, without what was skipped
        self._skipped_ns = 0  # long pauses, and jumps of the recorder's clock
        self._step_ns = round(1e9 / moments_per_s) if moments_per_s else None
        self._next_ns = 0  # when the next moment is

        self._frames = _Frames()
        self._map: Any = None  # nav_msgs/msg/OccupancyGrid
        self._recoveries = 0
        self._begin_in("")

        hearers: dict[str, Callable[[Any], None]] = {
            MAP: self._hear_map,
            ODOMETRY: self._hear_odometry,
            TRANSFORMS: self._hear_transforms,
            STATIC_TRANSFORMS: self._frames.hear,
        }
        if moments_per_s:
            hearers |= {
                PLAN: self._hear_plan,
                LOCAL_COSTMAP: self._hear_costmap,
                BEHAVIOR_TREE: self._hear_behaviors,
            }
        self._hearers = {
            topic: hear for role, hear in hearers.items() for topic in roles.found[role].topics
        }
        if attacked:
            self._hearers[ATTACKED] = self._hear_attacked_scan
        scans = [topic for topic in roles.found[SCAN].topics if topic != ATTACKED]
        if scans and (moments_per_s or not attacked):
            self._hearers[scans[0]] = self._hear_scan

    @property
    def topics(self) -> set[str]:
        """What is to be heard."""
        return set(self._hearers)

    def hear(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Take one message in."""
        pause_ns = stamp_ns - self._run.bag.start_ns - self._skipped_ns - self._now_ns
        self._skipped_ns += pause_ns if pause_ns > LONGEST_PAUSE_NS else 0
        self._now_ns = stamp_ns - self._run.bag.start_ns - self._skipped_ns
        while self._step_ns and self._next_ns < self._now_ns:
            self._remember(self._next_ns * 1e-9)
            self._next_ns += self._step_ns
        self._hearers[topic](message)

    def scene(self) -> ReplayScene:
        """Return all that was heard; errors are those of `run_scene`."""
        run, manifest = self._run, self._run.manifest
        if not self._way:
            raise ReportError(
                f"{run.path} cannot be drawn: its bag has neither odometry nor a transform to "
                f"{' or '.join(BASES)}, so the robot's pose is unknown."
            )
        ground = None if self._map is None else self._grid(self._map)
        if self._map is not None and ground is None:
            raise ReportError(
                f"{run.path} cannot be drawn: its bag has a map, but a broken one, or no transform "
                f"from {self._map.header.frame_id} to {self._root}; record /tf and /tf_static too."
            )
        if self._step_ns:
            self._remember(max(run.duration_s - self._skipped_ns * 1e-9, self._now_ns * 1e-9))
        path = _xy(np.array(self._way))
        scene = ReplayScene(
            title=printable(run.path.resolve().name),
            frame=self._root,
            map=ground,
            path=path,
            start=(path[0, 0], path[0, 1]),
            duration_s=run.duration_s,
            moments=tuple(self._moments),
        )
        if manifest is None:
            return scene
        return replace(
            scene,
            title=f"{manifest.key}, {manifest.outcome}",
            start=(manifest.start.x, manifest.start.y),
            goals=np.array([(g.x, g.y, g.yaw) for g in manifest.goals]).reshape(-1, 3),
            results=manifest.goal_results,
            onset_s=self._onset_s,
            disc=self._disc(),
            obstacle=self._obstacle(manifest),
            scan=None if self._closest_scan is None else _xy(self._closest_scan),
        )

    def _begin_in(self, root: str) -> None:
        """Start in a frame, and drop what was placed in another."""
        self._root = root
        self._way: list[complex] = []
        self._robot: _Placed = (0j, 1 + 0j)
        self._scan = self._attacked = self._plan = _NO_POINTS
        self._costmap: DrawnGrid | None = None
        self._moments: list[Moment] = []
        self._closest = np.inf
        self._closest_scan: _Points | None = None

    def _hear_map(self, message: Any) -> None:
        self._map = message

    def _hear_transforms(self, message: Any) -> None:
        self._frames.hear(message)
        if not self._has_odometry:
            self._drive(next((base for base in BASES if base in self._frames), ""))

    def _hear_odometry(self, message: Any) -> None:
        pose = message.pose.pose
        self._frames.hang(message, message.child_frame_id, pose.position, pose.orientation)
        self._drive(message.child_frame_id)

    def _hear_scan(self, message: Any) -> None:
        self._scan = self._hits(message)
        if ATTACKED not in self._hearers:
            self._keep_closest(self._scan)

    def _hear_attacked_scan(self, message: Any) -> None:
        self._attacked = self._hits(message)
        self._keep_closest(self._attacked)

    def _keep_closest(self, scan: _Points) -> None:
        """Keep a scan if it is the closest to what the picture shows."""
        fake, halfway_s = self._fake_object(), self._run.duration_s / 2
        off = abs(self._now_ns * 1e-9 - halfway_s) if fake is None else abs(self._robot[0] - fake)
        if len(scan) and off < self._closest:
            self._closest, self._closest_scan = off, scan

    def _hear_plan(self, message: Any) -> None:
        if (placed := self._placed(message.header.frame_id)) is not None:
            points = [stamped.pose.position for stamped in message.poses]
            plan = np.array([complex(point.x, point.y) for point in points], dtype=np.complex128)
            self._plan = placed[0] + placed[1] * plan

    def _hear_costmap(self, message: Any) -> None:
        self._costmap = self._grid(message)

    def _hear_behaviors(self, message: Any) -> None:
        self._recoveries += sum(
            change.node_name == RECOVERY
            and (change.previous_status, change.current_status) == ("IDLE", "RUNNING")
            for change in message.event_log
        )

    def _drive(self, base: str) -> None:
        """Note where the robot's base is now."""
        root, robot = self._frames.from_root(base)
        if not root or root in BASES:  # the robot's pose is unknown
            return
        if root != self._root:
            self._begin_in(root)
        if not self._way or abs(robot[0] - self._way[-1]) > LEAST_STEP_M:
            self._way.append(robot[0])
        self._robot = robot

    def _placed(self, frame: str) -> _Placed | None:
        """Return where a frame is in the scene, if that is known."""
        root, placed = self._frames.from_root(frame)
        return placed if root == self._root else None

    def _hits(self, scan: Any) -> _Points:
        """Return where the rays of a scan ended."""
        if not hasattr(scan, "ranges"):
            scan = sliced(scan)
        sensor = self._placed(scan.header.frame_id)
        if sensor is None:
            return _NO_POINTS
        ranges = np.asarray(scan.ranges, dtype=np.float64)
        hit = np.flatnonzero((ranges >= scan.range_min) & (ranges <= scan.range_max))
        bearings = scan.angle_min + scan.angle_increment * hit
        return np.asarray(sensor[0] + sensor[1] * ranges[hit] * np.exp(1j * bearings))

    def _grid(self, message: Any) -> DrawnGrid | None:
        """Return an occupancy grid where it lies in the scene."""
        placed = self._placed(message.header.frame_id)
        if placed is None:
            return None
        info = message.info
        origin = _pose(info.origin.position, info.origin.orientation)
        cells = np.asarray(message.data, dtype=np.int8)
        if origin is None or not cells.size or cells.size != info.height * info.width:
            return None
        corner, turn = origin
        return DrawnGrid(
            cells.reshape(info.height, info.width),
            info.resolution,
            _x_y_yaw((placed[0] + placed[1] * corner, placed[1] * turn)),
        )

    def _fake_object(self) -> complex | None:
        """Return where the object that is not there is by the newest transform."""
        if "radius" not in self._attack:
            return None
        frame = self._placed(self._attack["frame"])
        return frame and frame[0] + frame[1] * complex(self._attack["x"], self._attack["y"])

    def _disc(self) -> tuple[float, float, float] | None:
        fake = self._fake_object()
        return None if fake is None else (fake.real, fake.imag, self._attack["radius"])

    def _obstacle(self, manifest: Manifest) -> tuple[float, float, float] | None:
        """Return where a real obstacle was put that is on no map, by the recipe."""
        drawn, there = manifest.recipe.get("fake_object"), self._placed(MAP_FRAME)
        if drawn is None or there is None or not manifest.recipe["conditions"].get("obstacle"):
            return None
        place = there[0] + there[1] * complex(drawn["x"], drawn["y"])
        return place.real, place.imag, drawn["radius"]

    def _remember(self, time_s: float) -> None:
        if not self._way:
            return
        if len(self._moments) >= MOST_MOMENTS:
            raise ReportError(
                f"{self._run.path} has more than {MOST_MOMENTS} frames (MOST_MOMENTS); lower "
                "--frames, or cut the recording into shorter ones."
            )
        attacked = self._onset_s is not None and time_s >= self._onset_s
        self._moments.append(
            Moment(
                time_s=time_s,
                robot=_x_y_yaw(self._robot),
                driven=len(self._way),
                scan=_xy(self._scan),
                attacked=_xy(self._attacked),
                plan=_xy(self._plan),
                costmap=self._costmap,
                disc=self._disc() if attacked else None,
                recoveries=self._recoveries,
            )
        )


class _Frames:
    """Which frame hangs from which, as last heard."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, _Placed]] = {}

    def __contains__(self, frame: str) -> bool:
        return frame in self._parents

    def hear(self, message: Any) -> None:
        """Take a tf2_msgs/msg/TFMessage in."""
        for heard in message.transforms:
            step = heard.transform
            self.hang(heard, heard.child_frame_id, step.translation, step.rotation)

    def hang(self, stamped: Any, child: str, position: Any, orientation: Any) -> None:
        """Hang a frame from that of a stamped message; one that is nowhere stays where it was."""
        if (placed := _pose(position, orientation)) is not None:
            self._parents[child] = (stamped.header.frame_id, placed)

    def from_root(self, frame: str) -> tuple[str, _Placed]:
        """Return the frame from which a frame hangs in the end, and where it is in that.

        The name of the root is empty if the frames hang in a ring.
        """
        at, turn = 0j, 1 + 0j
        for _ in range(len(self._parents) + 1):
            if frame not in self._parents:
                return frame, (at, turn)
            frame, (offset, rotation) = self._parents[frame]
            at, turn = offset + rotation * at, rotation * turn
        return "", (at, turn)


def _pose(position: Any, q: Any) -> _Placed | None:
    """Return a pose in the plane; None if it is no number, or farther than any robot gets."""
    at = complex(position.x, position.y)
    turn = complex(1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.w * q.z + q.x * q.y))
    if not abs(at) < FARTHEST_M or not 0.0 < abs(turn) < math.inf:
        return None
    return at, turn / abs(turn)


def _x_y_yaw(placed: _Placed) -> tuple[float, float, float]:
    at, turn = placed
    return at.real, at.imag, cmath.phase(turn)


def _xy(points: _Points) -> NDArray[np.float64]:
    return np.column_stack([points.real, points.imag])
