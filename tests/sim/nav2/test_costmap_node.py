import math

import numpy as np
import pytest

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.geometry import Pose2D
from sim.middleware.stamps import header
from sim.middleware.tf import TransformListener
from sim.nav2.costmap import FREE_SPACE, LETHAL, NO_INFORMATION
from sim.nav2.costmap_node import GlobalCostmap, LocalCostmap
from sim.nav2.footprint import FOOTPRINT
from sim.nav2.inflation import Inflation
from sim.nav2.map_server import MapServer, OccupancyMap
from tests.sim.nav2.robot import IdealRobot

LaserScan = message_class("sensor_msgs/msg/LaserScan")
SCAN = "sensor_msgs/msg/LaserScan"
SOURCES = ("/scan", "/scan_fakeobject")
TYPES = {
    "costmap": ("nav_msgs/msg/OccupancyGrid", qos.LATCHED),
    "costmap_raw": ("nav2_msgs/msg/Costmap", qos.LATCHED),
    "costmap_updates": ("map_msgs/msg/OccupancyGridUpdate", qos.LATCHED),
    "published_footprint": ("geometry_msgs/msg/PolygonStamped", qos.DEFAULT),
    "voxel_grid": ("nav2_msgs/msg/VoxelGrid", qos.LATCHED),
    "clearing_endpoints": ("sensor_msgs/msg/PointCloud2", qos.LATCHED),
}


def make_map(size=80):
    data = np.zeros((size, size), np.int8)
    data[:, 0] = -1
    data[70, 70] = 100
    return OccupancyMap(data, 0.05, (-2.0, -2.0))


class Rig:
    """A robot that stands still, a costmap, and subscriptions to all its topics."""

    def __init__(self, kind, **settings):
        self.robot = IdealRobot("/cmd_vel")
        domain = self.robot.domain
        rng = np.random.default_rng(1)
        self.costmap = kind(domain, self.robot.buffer, SOURCES, rng=rng, **settings)
        server = MapServer(domain, make_map())
        for node in (server, self.costmap):
            node.configure()
        server.activate()
        self.heard = {name: [] for name in TYPES}
        for name, (msgtype, profile) in TYPES.items():
            topic = f"/{self.costmap.label}/{name}"
            self.robot.create_subscription(msgtype, topic, self.heard[name].append, profile)
        self._voices = {}
        self.robot.run(0.1)
        assert self.costmap.activate()

    def see(self, *ranges, topic="/scan", frame="base_footprint"):
        """Send a scan whose n-th beam points n quarter turns to the left."""
        if topic not in self._voices:
            self._voices[topic] = self.robot.create_publisher(SCAN, topic)
        readings = np.array(ranges, np.float32)
        quarter = math.pi / 2.0
        self._voices[topic].publish(
            LaserScan(
                header(self.robot.now_ns, frame),
                0.0, 0.0, quarter, 0.0, 0.0, 0.12, 20.0, readings, np.zeros(0, np.float32),
            )
        )  # fmt: skip

    def cost(self, x, y):
        grid = self.costmap.grid
        column, row = grid.cell(x, y)
        return grid.costs[row, column]


@pytest.fixture(params=[LocalCostmap, GlobalCostmap], ids=["local", "global"])
def rig(request):
    return Rig(request.param)


@pytest.fixture
def local():
    return Rig(LocalCostmap)


@pytest.fixture
def world():
    return Rig(GlobalCostmap)


def test_without_transforms_there_is_no_pose_and_no_activation():
    robot = IdealRobot("/cmd_vel")
    transforms = TransformListener(robot.domain, "1").buffer
    costmap = LocalCostmap(robot.domain, transforms, SOURCES, rng=np.random.default_rng(1))
    costmap.configure()
    assert costmap.robot_pose() is None  # no time has passed since it began to listen
    assert not costmap.activate()
    robot.run(0.1)
    assert costmap.robot_pose() == Pose2D()
    assert costmap.activate()


def test_global_costmap_waits_for_the_map():
    robot = IdealRobot("/cmd_vel")
    costmap = GlobalCostmap(robot.domain, robot.buffer, SOURCES, rng=np.random.default_rng(1))
    costmap.configure()
    robot.run(1.0)
    assert costmap.robot_pose() is not None
    assert not costmap.activate()


def test_local_costmap_rates_are_those_of_the_strict_publish_rule(local):
    local.see(1.0)
    local.robot.run(30.0)
    counts = {name: len(messages) for name, messages in local.heard.items()}
    assert counts["costmap"] == counts["costmap_raw"] == pytest.approx(50, abs=1)  # 1.67 Hz
    assert counts["published_footprint"] == counts["voxel_grid"] == pytest.approx(150, abs=1)
    assert counts["clearing_endpoints"] == pytest.approx(150, abs=1)
    assert counts["costmap_updates"] == 0


def test_global_costmap_goes_out_every_one_or_two_seconds(world):
    world.robot.run(60.0)
    counts = {name: len(messages) for name, messages in world.heard.items()}
    assert 0.55 * 60 < counts["costmap"] == counts["costmap_raw"] < 0.9 * 60
    assert counts["published_footprint"] == pytest.approx(60, abs=1)
    stamps = [m.header.stamp.sec for m in world.heard["costmap"]]
    assert set(np.diff(stamps)) <= {1, 2}
    assert counts["voxel_grid"] == counts["costmap_updates"] == 0


def test_obstacle_is_marked_and_inflated_in_the_costmaps_frame(rig):
    rig.see(1.02)
    rig.robot.run(2.5)
    assert rig.cost(1.02, 0.01) == LETHAL
    assert rig.cost(0.82, 0.01) == 253
    # 252 exp(-s (0.30 m - 0.2264 m)), by the scaling s.
    assert rig.cost(0.72, 0.01) == 202
    assert rig.cost(0.42, 0.01) == 0  # beyond the radius


def test_radius_and_scaling_of_the_inflation_can_be_set():
    rig = Rig(LocalCostmap, inflation=Inflation(radius=0.7, cost_scaling=10.0))
    rig.see(1.02)
    rig.robot.run(2.5)
    assert rig.cost(0.72, 0.01) == 120
    assert rig.cost(0.42, 0.01) > 0


def test_source_may_appear_late_and_its_last_scan_stays(rig):
    rig.see(1.4)
    rig.robot.run(2.5)
    assert rig.cost(0.82, 0.01) < 253
    rig.see(0.82, topic="/scan_fakeobject")
    for _ in range(5):
        rig.see(1.4)
        rig.robot.run(1.0)
    assert rig.cost(0.82, 0.01) == LETHAL  # silent again, but its last scan is still marked
    rig.see(1.4, topic="/scan_fakeobject")
    rig.robot.run(2.5)
    assert rig.cost(0.82, 0.01) < 253


def test_reading_without_return_neither_marks_nor_clears(rig):
    rig.see(1.02)
    rig.robot.run(1.5)
    rig.see(np.inf)
    rig.robot.run(1.5)
    assert rig.cost(1.02, 0.01) == LETHAL


def test_scan_waits_for_its_transform_and_is_placed_where_the_sensor_was(local):
    local.robot.run(0.195)  # the next update comes before the next odometry
    local.see(1.02)
    local.robot.pose = Pose2D(0.0, 0.5, 0.0)
    local.robot.run(0.01)
    assert local.cost(1.02, 0.01) == FREE_SPACE
    local.robot.run(0.2)
    marked = np.argwhere(local.costmap.grid.costs == LETHAL)
    assert len(marked) == 1
    y = local.costmap.grid.origin_y + (marked[0, 0] + 0.5) * 0.05
    assert y == pytest.approx(0.5 * 24 / 34, abs=0.026)  # 24 ms into a step of 34 ms


def test_window_rolls_with_the_robot_and_obstacles_stay_in_the_world(local):
    local.see(1.02)
    local.robot.run(0.5)
    local.see(np.inf)  # sees nothing from now on
    for x in (0.3, 0.6):
        local.robot.pose = Pose2D(x, 0.0, 0.0)
        local.robot.run(0.5)
        grid = local.costmap.grid
        assert grid.origin_x + 1.5 == pytest.approx(x, abs=0.051)
        assert local.cost(1.02, 0.01) == LETHAL
    for x in (-1.0, 0.0):  # out of the window and back
        local.robot.pose = Pose2D(x, 0.0, 0.0)
        local.robot.run(0.5)
    assert local.cost(1.02, 0.01) == FREE_SPACE


def test_voxels_are_free_marked_or_unknown(local):
    local.see(1.02)
    local.robot.run(0.5)
    message = local.heard["voxel_grid"][-1]
    columns = message.data.reshape(message.size_y, message.size_x)
    (row, column) = np.argwhere(columns == 0x0004FFFF)[0]
    assert message.origin.x + (column + 0.5) * 0.05 == pytest.approx(1.02, abs=0.026)
    assert message.origin.y + (row + 0.5) * 0.05 == pytest.approx(0.0, abs=0.026)
    assert np.sum(columns == 0x0004FFFF) == 1
    assert columns[row, column - 10] == 0x0000FFFB
    assert columns[row + 20, column] == 0x0000FFFF


def test_clearing_endpoints_stop_two_cells_before_the_hits(local):
    local.see(1.0, np.inf, 0.5)
    local.robot.run(0.5)
    cloud = local.heard["clearing_endpoints"][-1]
    assert (cloud.width, cloud.point_step, cloud.row_step) == (2, 12, 24)
    points = cloud.data.view(np.float32).reshape(-1, 3)
    assert points == pytest.approx(np.array([[0.9, 0.0, 0.132], [-0.4, 0.0, 0.132]]), abs=1e-6)


def test_footprint_is_published_where_the_robot_is(rig):
    rig.robot.pose = Pose2D(0.4, -0.2, 1.0)
    rig.robot.run(1.5)
    polygon = rig.heard["published_footprint"][-1]
    assert polygon.header.frame_id == rig.costmap.frame
    points = np.array([(p.x, p.y) for p in polygon.polygon.points])
    assert points == pytest.approx(rig.robot.pose.apply(FOOTPRINT))


def test_static_map_lies_under_the_obstacles(world):
    world.see(1.02)
    world.robot.run(2.5)
    assert world.cost(-2.0 + 70.5 * 0.05, -2.0 + 70.5 * 0.05) == LETHAL
    assert world.cost(-2.0 + 0.5 * 0.05, 0.0) == NO_INFORMATION
    assert world.cost(1.02, 0.01) == LETHAL
    assert world.cost(-1.0, 1.0) == FREE_SPACE


def test_clearing_entirely_forgets_obstacles_but_not_the_map(world):
    world.see(1.02)
    world.robot.run(1.2)
    world.see(np.inf)
    world.robot.run(1.2)
    assert world.cost(1.02, 0.01) == LETHAL
    client = world.robot.create_client("/global_costmap/clear_entirely_global_costmap")
    client.call(None)
    world.robot.run(0.01)
    assert not world.costmap.is_current
    world.robot.run(1.2)
    assert world.costmap.is_current
    assert world.cost(1.02, 0.01) == FREE_SPACE
    assert world.cost(-2.0 + 70.5 * 0.05, -2.0 + 70.5 * 0.05) == LETHAL
