"""The two costmap nodes: scans and the map in, grids, footprint and clearing services out.

How cells get their costs is in ``costmap_layers``. A server of the same process reads the node's
``grid`` and ``robot_pose()`` directly, as Nav2's controller and planner do.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from oracle_pipeline.bags.template import STAMP, Template
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import Pose2D
from sim.middleware.stamps import stamp_ns
from sim.middleware.tf import TransformBuffer, TransformError
from sim.nav2.costmap import (
    COSTMAP,
    FREE_SPACE,
    NO_INFORMATION,
    OCCUPANCY_GRID,
    Costmap2D,
    Points,
    costmap_message,
    occupancies,
    occupancy_grid,
)
from sim.nav2.costmap_layers import Observation, ObstacleLayer, shift, static_costs
from sim.nav2.footprint import FOOTPRINT, INSCRIBED_RADIUS, POLYGON, polygon_message
from sim.nav2.inflation import AS_SHIPPED, Inflation, InflationLayer
from sim.nav2.laser import scan_points
from sim.nav2.lifecycle import LifecycleNode, nothing
from sim.nav2.voxel_messages import CLOUD, VOXELS, LaserClouds, VoxelGrids

BASE_FRAME = "base_link"
_SCAN_QOS = qos.profile(50, reliable=False)
_WAKE_UP_JITTER_NS = MILLISECOND

LOCAL_SIZE = 60  # cells along an edge
LOCAL_RESOLUTION = 0.05  # [m]


class _ScanSource:
    """The latest scan of one topic whose transform to the costmap's frame is known.

    A scan waits until the transform at its stamp is known. As in Nav2 with persistence 0, the
    latest one stays valid until the next arrives, however old it gets.
    """

    def __init__(self, frame: str) -> None:
        self.observation: Observation | None = None
        self._frame = frame
        # Of two scans, the transform of the older one is known once transforms arrive.
        self._waiting: deque[Any] = deque(maxlen=2)

    def receive(self, scan: Any) -> None:
        """Store a ``sensor_msgs/msg/LaserScan``."""
        self._waiting.append(scan)

    def place(self, transforms: TransformBuffer) -> None:
        """Make the newest waiting scan whose transform is known the observation."""
        for index in reversed(range(len(self._waiting))):
            scan = self._waiting[index]
            time_ns = stamp_ns(scan.header.stamp)
            try:
                sensor = transforms.lookup(self._frame, scan.header.frame_id, time_ns)
            except TransformError:
                continue
            points = scan_points(scan, sensor)
            self.observation = Observation(time_ns, sensor.x, sensor.y, points)
            for _ in range(index + 1):
                self._waiting.popleft()
            return


class _CostmapNode(LifecycleNode):
    """Base class of the local and the global costmap.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    transforms
        What its transform listener fills.
    scan_topics
        Obstacle sources; their publishers may appear late or never.
    rng
        Generator for the delay of the update loop. Nav2 publishes when *more* than a period has
        passed, so this decides whether the global costmap goes out after one second or two.
    latency_ns
        From a scan's publication to its arrival.
    inflation
        How far costs reach around obstacles, and how fast they fall.

    Attributes
    ----------
    grid
        The costs, renewed at every update; read it, do not keep it.
    is_current
        False from a complete clearing to the next update: not fit to plan on.
    """

    label: ClassVar[str]
    frame: ClassVar[str]
    update_period_ns: ClassVar[int]
    publish_period_ns: ClassVar[int]
    clearing_margin: ClassVar[float] = 0.0  # see `ObstacleLayer` [m]

    def __init__(
        self, domain: Domain, transforms: TransformBuffer, scan_topics: Sequence[str], *,
        rng: np.random.Generator, latency_ns: int = 0, inflation: Inflation = AS_SHIPPED,
    ) -> None:  # fmt: skip
        label = self.label
        super().__init__(domain, f"/{label}/{label}", bond=False, rng=rng, latency_ns=latency_ns)
        self.is_current = True
        self._inflated_by = inflation
        self._transforms = transforms
        self.set_grid(self.initial_grid())
        self._published_ns = 0

        self._footprint = self.create_publisher(POLYGON, f"/{label}/published_footprint")
        self._outline = Template(
            polygon_message(0, self.frame, FOOTPRINT), POLYGON, (*STAMP, "polygon.points")
        )
        self._occupancy = self.create_publisher(OCCUPANCY_GRID, f"/{label}/costmap", qos.LATCHED)
        self._raw = self.create_publisher(COSTMAP, f"/{label}/costmap_raw", qos.LATCHED)
        # Publishes nothing, because always_send_full_costmap is set.
        self.create_publisher(
            "map_msgs/msg/OccupancyGridUpdate", f"/{label}/costmap_updates", qos.LATCHED
        )
        self.create_subscription(
            "geometry_msgs/msg/Polygon", f"/{label}/footprint", None, qos.SYSTEM
        )
        self._sources = [_ScanSource(self.frame) for _ in scan_topics]
        for topic, source in zip(scan_topics, self._sources, strict=True):
            self.create_subscription("sensor_msgs/msg/LaserScan", topic, source.receive, _SCAN_QOS)
        for service, srvtype, handler in (
            (f"clear_except_{label}", "ClearCostmapExceptRegion", nothing),
            (f"clear_around_{label}", "ClearCostmapAroundRobot", nothing),
            (f"clear_entirely_{label}", "ClearEntireCostmap", self._clear_entirely),
            ("get_costmap", "GetCostmap", nothing),
        ):
            self.create_service(f"nav2_msgs/srv/{srvtype}", f"/{label}/{service}", handler)

    def is_ready(self) -> bool:
        """Return whether the robot's pose is known, which activation waits for."""
        return self.robot_pose() is not None

    def on_activate(self) -> None:
        """Start the update loop."""
        self.create_timer(self.update_period_ns, self._wake_up, phase_ns=0)

    def robot_pose(self) -> Pose2D | None:
        """Return the robot's latest pose in the costmap's frame; None while it is not known."""
        try:
            return self._transforms.lookup(self.frame, BASE_FRAME)
        except TransformError:
            return None

    def update(self) -> None:
        """Bring the grid up to date; nothing happens while the robot's pose is not known."""
        pose = self.robot_pose()
        if pose is None:
            return
        for source in self._sources:
            source.place(self._transforms)
        observations = [s.observation for s in self._sources if s.observation is not None]
        footprint = pose.apply(FOOTPRINT)
        self.follow(pose)
        cleared = self.obstacles.update(self.grid, observations, footprint)
        costs = self._background.copy()
        self.obstacles.add_to(costs)
        self._inflation.add_to(costs)
        self.grid.costs = costs
        self.is_current = True
        self.publish_layers(observations, cleared)
        self._footprint.publish_serialized(self._outline.data(*self.stamp, _points32(footprint)))

    def initial_grid(self) -> Costmap2D:
        """Return the grid to begin with."""
        raise NotImplementedError

    def follow(self, pose: Pose2D) -> None:
        """Move the grid with the robot, if it rolls."""

    def publish_layers(
        self, observations: Sequence[Observation], cleared: Sequence[Points]
    ) -> None:
        """Publish a layer's own topics at every update, with the ends of the cleared beams."""

    def set_grid(self, grid: Costmap2D) -> None:
        """Restart on another grid, with its costs as those below the obstacles."""
        self.grid = grid
        self._background = grid.costs
        self.obstacles = ObstacleLayer(grid, margin=self.clearing_margin)
        self._inflation = InflationLayer(grid.resolution, INSCRIBED_RADIUS, self._inflated_by)
        if grid.costs.size:
            place = ("origin.position.x", "origin.position.y")
            self._raw_bytes = Template(
                costmap_message(0, grid), COSTMAP,
                (*STAMP, *(f"metadata.{field}" for field in place), "data"),
            )  # fmt: skip
            self._occupancy_bytes = Template(
                occupancy_grid(0, grid), OCCUPANCY_GRID,
                (*STAMP, *(f"info.{field}" for field in place), "data"),
            )  # fmt: skip

    def _wake_up(self) -> None:
        self.call_later(int(self.rng.integers(_WAKE_UP_JITTER_NS)), self._cycle)

    def _cycle(self) -> None:
        self.update()
        if self.now_ns - self._published_ns > self.publish_period_ns:
            self._published_ns = self.now_ns
            stamp, grid = self.stamp, self.grid
            origin = (grid.origin_x, grid.origin_y)
            if self._raw.has_subscribers():
                self._raw.publish(
                    costmap_message(self.now_ns, grid),
                    self._raw_bytes.data(*stamp, *origin, grid.costs),
                )
            if self._occupancy.has_subscribers():
                self._occupancy.publish_serialized(
                    self._occupancy_bytes.data(*stamp, *origin, occupancies(grid))
                )

    def _clear_entirely(self, _request: None) -> None:
        self.obstacles.reset()
        self.is_current = False


class LocalCostmap(_CostmapNode):
    """A window of 3 m that rolls with the robot in the odometry frame: voxels and inflation.

    The laser's plane is in a single level of the voxels, so one cost for each column is enough.
    """

    label = "local_costmap"
    frame = "odom"
    update_period_ns = SECOND // 5
    publish_period_ns = SECOND // 2
    clearing_margin = 2.0 * LOCAL_RESOLUTION

    def on_configure(self) -> None:
        """Advertise the topics of the voxel layer."""
        self._voxels = self.create_publisher(VOXELS, f"/{self.label}/voxel_grid", qos.LATCHED)
        self._endpoints = self.create_publisher(
            CLOUD, f"/{self.label}/clearing_endpoints", qos.LATCHED
        )
        self._voxel_grids = VoxelGrids(self.grid)
        self._clouds = LaserClouds(self.frame)

    def initial_grid(self) -> Costmap2D:
        """Return a free window, which jumps to the robot at the first update.

        Unknown space is not tracked here.
        """
        costs = np.full((LOCAL_SIZE, LOCAL_SIZE), FREE_SPACE, np.uint8)
        return Costmap2D(costs, LOCAL_RESOLUTION, 0.0, 0.0, self.frame)

    def follow(self, pose: Pose2D) -> None:
        """Keep the robot in the middle cell; the costs outside the window are lost."""
        grid = self.grid
        half = LOCAL_SIZE * LOCAL_RESOLUTION / 2.0
        columns, rows = grid.cell(pose.x - half, pose.y - half)
        if columns or rows:
            self.obstacles.costs = shift(self.obstacles.costs, columns, rows, NO_INFORMATION)
            grid.origin_x += columns * grid.resolution
            grid.origin_y += rows * grid.resolution

    def publish_layers(
        self, observations: Sequence[Observation], cleared: Sequence[Points]
    ) -> None:
        """Publish the voxels, and per source where its beams stopped clearing."""
        if self._voxels.has_subscribers():
            self._voxels.publish_serialized(
                self._voxel_grids.data(self.now_ns, self.grid, self.obstacles.costs)
            )
        if self._endpoints.has_subscribers():
            for seen, ends in zip(observations, cleared, strict=True):
                self._endpoints.publish_serialized(self._clouds.data(seen.stamp_ns, ends))


class GlobalCostmap(_CostmapNode):
    """The whole map, obstacles on it, and inflation; it is empty until the map arrives."""

    label = "global_costmap"
    frame = "map"
    update_period_ns = SECOND
    publish_period_ns = SECOND

    def on_configure(self) -> None:
        """Subscribe to the map."""
        self.create_subscription("nav_msgs/msg/OccupancyGrid", "/map", self._on_map, qos.LATCHED)

    def initial_grid(self) -> Costmap2D:
        """Return a grid without cells."""
        return Costmap2D(np.empty((0, 0), np.uint8), LOCAL_RESOLUTION, 0.0, 0.0, self.frame)

    def is_ready(self) -> bool:
        """Return whether map and robot's pose are known."""
        return self.grid.costs.size > 0 and super().is_ready()

    def _on_map(self, message: Any) -> None:
        meta = message.info
        costs = static_costs(message.data.reshape(meta.height, meta.width))
        corner = meta.origin.position
        self.set_grid(Costmap2D(costs, meta.resolution, corner.x, corner.y, self.frame))


def _points32(points: Points) -> list[float]:
    """Return points of shape (n, 2) as ``geometry_msgs/msg/Point32`` has them: x, y, z of each."""
    return [number for x, y in points.tolist() for number in (x, y, 0.0)]
