"""Builds the scene of an opened run, in one pass over its bag and manifest.

Topics are found by role, as for features. The path is that of the robot's base, from transforms and
odometry, in the root frame: map, or odom without localisation. Everything is planar, so a point is
a complex number [m] and a rotation a complex factor. ``oracle_pipeline.replay.scene`` draws it.
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
from oracle_pipeline.features.engine.point_clouds import sliced
from oracle_pipeline.opened_run import OpenedRun
from oracle_pipeline.replay.scene import DrawnGrid, Moment, ReplayScene
from oracle_pipeline.reporting.stored_report import ReportError
from oracle_pipeline.robots import roles as role
from oracle_pipeline.robots.robot import find_robots

MOST_MOMENTS = 20_000  # of a film
FARTHEST_M = 1e8
LONGEST_PAUSE_NS = 60_000_000_000  # without a message, in the film
MAP_FRAME = "map"  # REP 105; the frame of recipes
ATTACKED = "/scan_fakeobject"  # of simulated runs
BASES = ("base_footprint", "base_link")  # REP 105 and 120
RECOVERY = "RecoveryActions"  # parent node of recoveries in Nav2's behaviour trees
LEAST_STEP_M = 0.01  # least distance between two points of the path

_Points = NDArray[np.complex128]
_Pose = tuple[complex, complex]  # position and rotation
_NO_POINTS: _Points = np.zeros(0, dtype=np.complex128)


def run_scene(run: OpenedRun, moments_per_s: float | None = None) -> ReplayScene:
    """Read the scene of a run or a foreign bag; if there are several robots, of the first.

    Parameters
    ----------
    run : Run
        Map, goals and attack are in the scene as far as bag and manifest have them.
    moments_per_s : float, optional
        Moments per second of the recording; by default the scene has none.

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
        story.update(raw.topic, raw.stamp_ns, run.bag.deserialize(raw))
    return story.scene()


class _Story:
    """The state of a run, updated by its messages in the order of recording.

    One scan is kept for the still picture: the attacked scan taken nearest to the fake object, or
    else the scan (attacked, if there is an attack) nearest to the middle of the recording.
    """

    def __init__(self, run: OpenedRun, roles: role.Roles, moments_per_s: float | None) -> None:
        self._run = run
        attacked = run.manifest if run.manifest and run.manifest.label == "malicious" else None
        self._attack = attacked.attack if attacked else {}
        self._onset_s = attacked.onset_s if attacked else None
        self._has_odometry = bool(roles.found[role.ODOMETRY].topics)
        self._now_ns = 0  # since the start of the recording, without what was skipped
        self._skipped_ns = 0  # long pauses, and jumps of the recorder's clock
        self._step_ns = round(1e9 / moments_per_s) if moments_per_s else None
        self._next_ns = 0  # when the next moment is

        self._frames = _Frames()
        self._map: Any = None  # nav_msgs/msg/OccupancyGrid
        self._recoveries = 0
        self._start_in("")

        handlers: dict[str, Callable[[Any], None]] = {
            role.MAP: self._on_map,
            role.ODOMETRY: self._on_odometry,
            role.TRANSFORMS: self._on_transforms,
            role.STATIC_TRANSFORMS: self._frames.update,
        }
        if moments_per_s:
            handlers |= {
                role.PLAN: self._on_plan,
                role.LOCAL_COSTMAP: self._on_costmap,
                role.BEHAVIOR_TREE: self._on_behaviors,
            }
        self._handlers = {
            topic: handle for role, handle in handlers.items() for topic in roles.found[role].topics
        }
        if attacked:
            self._handlers[ATTACKED] = self._on_attacked_scan
        scans = [topic for topic in roles.found[role.SCAN].topics if topic != ATTACKED]
        if scans and (moments_per_s or not attacked):
            self._handlers[scans[0]] = self._on_scan

    @property
    def topics(self) -> set[str]:
        """The topics to read."""
        return set(self._handlers)

    def update(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Process one message."""
        pause_ns = stamp_ns - self._run.bag.start_ns - self._skipped_ns - self._now_ns
        self._skipped_ns += pause_ns if pause_ns > LONGEST_PAUSE_NS else 0
        self._now_ns = stamp_ns - self._run.bag.start_ns - self._skipped_ns
        while self._step_ns and self._next_ns < self._now_ns:
            self._add_moment(self._next_ns * 1e-9)
            self._next_ns += self._step_ns
        self._handlers[topic](message)

    def scene(self) -> ReplayScene:
        """Return the scene; errors are those of `run_scene`."""
        run, manifest = self._run, self._run.manifest
        if not self._path:
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
            self._add_moment(max(run.duration_s - self._skipped_ns * 1e-9, self._now_ns * 1e-9))
        path = _xy(np.array(self._path))
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

    def _start_in(self, root: str) -> None:
        """Start in a root frame, and drop data from another."""
        self._root = root
        self._path: list[complex] = []
        self._robot: _Pose = (0j, 1 + 0j)
        self._scan = self._attacked = self._plan = _NO_POINTS
        self._costmap: DrawnGrid | None = None
        self._moments: list[Moment] = []
        self._closest = np.inf
        self._closest_scan: _Points | None = None

    def _on_map(self, message: Any) -> None:
        self._map = message

    def _on_transforms(self, message: Any) -> None:
        self._frames.update(message)
        if not self._has_odometry:
            self._drive(next((base for base in BASES if base in self._frames), ""))

    def _on_odometry(self, message: Any) -> None:
        pose = message.pose.pose
        self._frames.attach(message, message.child_frame_id, pose.position, pose.orientation)
        self._drive(message.child_frame_id)

    def _on_scan(self, message: Any) -> None:
        self._scan = self._hits(message)
        if ATTACKED not in self._handlers:
            self._keep_closest(self._scan)

    def _on_attacked_scan(self, message: Any) -> None:
        self._attacked = self._hits(message)
        self._keep_closest(self._attacked)

    def _keep_closest(self, scan: _Points) -> None:
        """Keep a scan if it is the best so far for the still picture."""
        fake, halfway_s = self._fake_object(), self._run.duration_s / 2
        off = abs(self._now_ns * 1e-9 - halfway_s) if fake is None else abs(self._robot[0] - fake)
        if len(scan) and off < self._closest:
            self._closest, self._closest_scan = off, scan

    def _on_plan(self, message: Any) -> None:
        if (pose := self._pose_of(message.header.frame_id)) is not None:
            points = [stamped.pose.position for stamped in message.poses]
            plan = np.array([complex(point.x, point.y) for point in points], dtype=np.complex128)
            self._plan = pose[0] + pose[1] * plan

    def _on_costmap(self, message: Any) -> None:
        self._costmap = self._grid(message)

    def _on_behaviors(self, message: Any) -> None:
        self._recoveries += sum(
            change.node_name == RECOVERY
            and (change.previous_status, change.current_status) == ("IDLE", "RUNNING")
            for change in message.event_log
        )

    def _drive(self, base: str) -> None:
        """Update the pose of the robot's base."""
        root, robot = self._frames.from_root(base)
        if not root or root in BASES:  # the robot's pose is unknown
            return
        if root != self._root:
            self._start_in(root)
        if not self._path or abs(robot[0] - self._path[-1]) > LEAST_STEP_M:
            self._path.append(robot[0])
        self._robot = robot

    def _pose_of(self, frame: str) -> _Pose | None:
        """Return the pose of a frame in the scene, if known."""
        root, pose = self._frames.from_root(frame)
        return pose if root == self._root else None

    def _hits(self, scan: Any) -> _Points:
        """Return the end points of the rays of a scan."""
        if not hasattr(scan, "ranges"):
            scan = sliced(scan)
        sensor = self._pose_of(scan.header.frame_id)
        if sensor is None:
            return _NO_POINTS
        ranges = np.asarray(scan.ranges, dtype=np.float64)
        hit = np.flatnonzero((ranges >= scan.range_min) & (ranges <= scan.range_max))
        bearings = scan.angle_min + scan.angle_increment * hit
        return np.asarray(sensor[0] + sensor[1] * ranges[hit] * np.exp(1j * bearings))

    def _grid(self, message: Any) -> DrawnGrid | None:
        """Return an occupancy grid with its pose in the scene."""
        pose = self._pose_of(message.header.frame_id)
        if pose is None:
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
            _x_y_yaw((pose[0] + pose[1] * corner, pose[1] * turn)),
        )

    def _fake_object(self) -> complex | None:
        """Return the position of the fake object by the newest transform."""
        if "radius" not in self._attack:
            return None
        frame = self._pose_of(self._attack["frame"])
        return frame and frame[0] + frame[1] * complex(self._attack["x"], self._attack["y"])

    def _disc(self) -> tuple[float, float, float] | None:
        fake = self._fake_object()
        return None if fake is None else (fake.real, fake.imag, self._attack["radius"])

    def _obstacle(self, manifest: Manifest) -> tuple[float, float, float] | None:
        """Return the real unmapped obstacle of the recipe."""
        drawn, map_pose = manifest.recipe.get("fake_object"), self._pose_of(MAP_FRAME)
        if drawn is None or map_pose is None or not manifest.recipe["conditions"].get("obstacle"):
            return None
        place = map_pose[0] + map_pose[1] * complex(drawn["x"], drawn["y"])
        return place.real, place.imag, drawn["radius"]

    def _add_moment(self, time_s: float) -> None:
        if not self._path:
            return
        if len(self._moments) >= MOST_MOMENTS:
            raise ReportError(
                f"{self._run.path} has more than {MOST_MOMENTS} frames (MOST_MOMENTS); lower "
                "--frames, or cut the recording into shorter ones."
            )
        attacked = self._onset_s is not None and time_s >= self._onset_s
        self._moments.append(
            Moment(
                time_s=time_s, robot=_x_y_yaw(self._robot), driven=len(self._path),
                scan=_xy(self._scan), attacked=_xy(self._attacked), plan=_xy(self._plan),
                costmap=self._costmap, disc=self._disc() if attacked else None,
                recoveries=self._recoveries,
            )
        )  # fmt: skip


class _Frames:
    """The newest transforms, as a tree of frames."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, _Pose]] = {}

    def __contains__(self, frame: str) -> bool:
        return frame in self._parents

    def update(self, message: Any) -> None:
        """Process a tf2_msgs/msg/TFMessage."""
        for stamped in message.transforms:
            step = stamped.transform
            self.attach(stamped, stamped.child_frame_id, step.translation, step.rotation)

    def attach(self, stamped: Any, child: str, position: Any, orientation: Any) -> None:
        """Attach a frame to that of a stamped message, unless its pose is invalid."""
        if (pose := _pose(position, orientation)) is not None:
            self._parents[child] = (stamped.header.frame_id, pose)

    def from_root(self, frame: str) -> tuple[str, _Pose]:
        """Return the root of a frame, and the frame's pose in it.

        The name of the root is empty if the frames form a cycle.
        """
        at, turn = 0j, 1 + 0j
        for _ in range(len(self._parents) + 1):
            if frame not in self._parents:
                return frame, (at, turn)
            frame, (offset, rotation) = self._parents[frame]
            at, turn = offset + rotation * at, rotation * turn
        return "", (at, turn)


def _pose(position: Any, q: Any) -> _Pose | None:
    """Return a planar pose, or None if it is not finite or beyond `FARTHEST_M`."""
    at = complex(position.x, position.y)
    turn = complex(1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.w * q.z + q.x * q.y))
    if not abs(at) < FARTHEST_M or not 0.0 < abs(turn) < math.inf:
        return None
    return at, turn / abs(turn)


def _x_y_yaw(pose: _Pose) -> tuple[float, float, float]:
    at, turn = pose
    return at.real, at.imag, cmath.phase(turn)


def _xy(points: _Points) -> NDArray[np.float64]:
    return np.column_stack([points.real, points.imag])
