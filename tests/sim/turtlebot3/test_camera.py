import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND, Executor
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.turtlebot3 import camera
from sim.turtlebot3.arena import HEXAGON, RING
from sim.turtlebot3.camera import HEIGHT, WIDTH, add_depth_camera, in_depth_range
from sim.turtlebot3.mjcf import WorldParameters
from sim.turtlebot3.world import World

# CDR bytes of the topics on Humble (fact sheet, section 10.1).
SIZES = {
    "/intel_realsense_r200_depth/camera_info": 373,
    "/intel_realsense_r200_depth/depth/camera_info": 373,
    "/intel_realsense_r200_depth/depth/image_raw": 307_264,
    "/intel_realsense_r200_depth/image_raw": 230_464,
    "/intel_realsense_r200_depth/points": 2_457_745,
}
COLOUR_INFO, DEPTH_INFO, DEPTH, COLOUR, POINTS = SIZES
# The camera in the robot's frame: base_link, camera_link, camera_depth_frame.
X, Y, Z = 0.064 + 0.005, -0.065 + 0.028, 0.010 + 0.094 + 0.013


class Rig:
    def __init__(self, start, *, renders=True):
        self.world = World(WorldParameters(start))
        self.executor = Executor(self.world.advance_to)
        self.domain = Domain(self.executor)
        add_depth_camera(self.domain, self.world, renders=renders)
        self.tester = Node(self.domain, "/tester")
        self.heard = {}

    def listen(self, topic, **options):
        self.heard[topic] = []
        msgtype = self.domain.topics[topic]
        self.tester.create_subscription(msgtype, topic, self.heard[topic].append, **options)

    def shoot(self, *topics):
        """Return the message of the first picture on each topic."""
        for topic in topics:
            self.listen(topic)
        self.executor.run_until(camera.PERIOD_NS)
        return [message for topic in topics for message in self.heard[topic]]


def floats(message):
    return message.data.view(np.float32)


def test_pictures_come_five_times_a_second_as_large_as_on_humble():
    rig = Rig(Pose2D(-2.0, -0.5))
    for topic in SIZES:
        rig.listen(topic, raw=True)
    rig.executor.run_until(SECOND)
    sizes = {topic: [*map(len, messages)] for topic, messages in rig.heard.items()}
    assert sizes == {topic: [size] * 5 for topic, size in SIZES.items()}


def test_without_a_rendering_context_the_topics_are_there_and_silent():
    rig = Rig(Pose2D(-2.0, -0.5), renders=False)
    for topic in SIZES:
        rig.listen(topic)
    rig.executor.run_until(SECOND)
    assert rig.heard == {topic: [] for topic in SIZES}


def test_topics_without_subscribers_are_not_published():
    rig = Rig(Pose2D(-2.0, -0.5))
    rig.tester.create_subscription(rig.domain.topics[POINTS], POINTS, None)
    rig.listen(DEPTH)
    rig.executor.run_until(SECOND)
    sent = {p.topic: p.messages for p in rig.domain.publishers() if p.topic in SIZES}
    assert sent == {**dict.fromkeys(SIZES, 0), DEPTH: 5}


@settings(max_examples=10)
@given(st.floats(-2.5, 2.5), st.floats(-2.4, 2.4), st.floats(-math.pi, math.pi))
def test_every_point_lies_on_the_floor_or_on_a_surface_of_the_arena(x, y, yaw):
    if HEXAGON.clearance(np.array([[x, y]]))[0] < 0.3:
        return
    start = Pose2D(x, y, yaw)
    (cloud,) = Rig(start).shoot(POINTS)
    right, down, forward = floats(cloud).reshape(-1, 8)[:, :3].astype(np.float64).T
    seen = np.isfinite(forward)
    assert seen.sum() > 0.3 * len(seen)  # the floor alone fills a third
    ground = start.compose(Pose2D(X, Y)).apply(np.column_stack([forward, -right])[seen])
    height = Z - down[seen]
    on_floor = np.abs(height) < 1e-3
    on_surface = np.abs(HEXAGON.clearance(ground)) < 1e-3
    over_the_wall = height > RING.z_max  # some blocks are higher and go on behind it
    assert (on_floor | on_surface | over_the_wall).all()
    assert height.min() > -1e-3


def test_depth_is_along_the_optical_axis_and_the_points_are_the_pixels_in_order():
    depth, cloud = Rig(Pose2D(-2.0, 0.0)).shoot(DEPTH, POINTS)
    image = floats(depth).reshape(HEIGHT, WIDTH)
    to_pillar = 2.0 - 1.1 - math.sqrt(0.15**2 - Y**2) - X
    assert image[HEIGHT // 2, WIDTH // 2] == pytest.approx(to_pillar, abs=1e-3)
    f = WIDTH / 2.0 / math.tan(1.047 / 2.0)
    row = HEIGHT - 1
    assert image[row] == pytest.approx(Z * f / (row - 119.5), rel=1e-5)  # level floor
    points = floats(cloud).reshape(HEIGHT, WIDTH, 8)
    assert (cloud.height, cloud.width, cloud.row_step) == (HEIGHT, WIDTH, 32 * WIDTH)
    assert np.array_equal(points[:, :, 2], image)
    assert points[row, 0, :2] == pytest.approx(
        [-159.5 / f * image[row, 0], 119.5 / f * image[row, 0]], rel=1e-5
    )
    assert not cloud.is_dense


def test_points_have_the_colours_of_the_image():
    colour, cloud = Rig(Pose2D(-2.0, 0.0)).shoot(COLOUR, POINTS)
    blue, green, red, unused = cloud.data.reshape(-1, 32)[:, 16:20].T
    assert np.array_equal(np.column_stack([red, green, blue]), colour.data.reshape(-1, 3))
    assert not unused.any()


def test_sky_pillar_and_floor_differ_in_colour_and_a_side_in_the_shade_is_darker():
    (colour,) = Rig(Pose2D(-2.4, 0.0)).shoot(COLOUR)
    image = colour.data.reshape(HEIGHT, WIDTH, 3)
    pillar = image[HEIGHT // 2, WIDTH // 2]
    assert len(np.unique([image[0, WIDTH // 2], pillar, image[-1, WIDTH // 2]], axis=0)) == 3
    (colour,) = Rig(Pose2D(-0.2, 0.0, math.pi)).shoot(COLOUR)  # the same pillar from the sunny side
    assert (colour.data.reshape(HEIGHT, WIDTH, 3)[HEIGHT // 2, WIDTH // 2] > pillar).all()


@pytest.mark.parametrize(
    ("depth", "reported"),
    [(0.0005, -math.inf), (0.5, 0.5), (4.75, 4.75), (5.5, math.inf), (math.inf, math.inf)],
)
def test_depths_outside_the_limits_are_reported_as_rep_117_says(depth, reported):
    assert in_depth_range(np.array([depth]))[0] == reported


def test_the_calibration_is_that_of_the_driver():
    colour, depth = Rig(Pose2D(-2.0, 0.0)).shoot(COLOUR_INFO, DEPTH_INFO)
    for info in (colour, depth):
        assert (info.width, info.height, info.header.frame_id) == (320, 240, "camera_depth_frame")
        assert info.k.tolist() == pytest.approx([277.19, 0, 160.5, 0, 277.19, 120.5, 0, 0, 1], 1e-4)
        assert info.p[3] == pytest.approx(-277.19 * 0.07, 1e-4)
