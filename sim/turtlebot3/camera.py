"""The depth camera: Gazebo's driver of the r200, as a node.

Without a rendering context, Gazebo's camera advertises its topics and publishes nothing. This one
does the same unless it gets a function that renders. Frame, sizes, rates and encodings are those of
Humble's Waffle.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.middleware.stamps import header
from sim.turtlebot3 import frames
from sim.turtlebot3.world import View, World

_CameraInfo = message_class("sensor_msgs/msg/CameraInfo")
_Image = message_class("sensor_msgs/msg/Image")
_PointCloud2 = message_class("sensor_msgs/msg/PointCloud2")
_PointField = message_class("sensor_msgs/msg/PointField")
_RegionOfInterest = message_class("sensor_msgs/msg/RegionOfInterest")

FRAME = "camera_depth_frame"  # turned as an optical frame: x right, y down, z forward
PERIOD_NS = 200 * MILLISECOND
_PHASE_NS = 160 * MILLISECOND  # phase of its own, like the other sensors

WIDTH, HEIGHT = 320, 240  # [pixels]
HORIZONTAL_FIELD_OF_VIEW = 1.047  # [rad]
FOCAL_LENGTH = WIDTH / (2.0 * math.tan(HORIZONTAL_FIELD_OF_VIEW / 2.0))  # [pixels]
BASELINE_M = 0.07  # of a stereo camera that would give this depth (the driver's hack_baseline)
MIN_DEPTH_M, MAX_DEPTH_M = 0.001, 5.0
_FAR_M = 100.0  # the colour image reaches further than the depth

_FLOAT32 = 7  # sensor_msgs/msg/PointField.datatype
_POINT_FIELDS = (("x", 0), ("y", 4), ("z", 8), ("rgb", 16))
_POINT_STEP = 32  # [bytes]

Look = Callable[[NDArray[np.float64], float], View]


class _DepthCamera(Node):
    """Publishes colour, depth and points, 5 times a second, for topics that have a receiver.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    look
        Returns what is visible along unit vectors of shape (n, 3), x forward, y left, z up, up to a
        distance [m]; None for a camera without a rendering context, which publishes nothing.
    """

    def __init__(self, domain: Domain, look: Look | None = None) -> None:
        super().__init__(domain, "/intel_realsense_r200_depth_driver")
        self._colour_info = self._advertise("camera_info", "CameraInfo")
        self._depth_info = self._advertise("depth/camera_info", "CameraInfo")
        self._depth = self._advertise("depth/image_raw", "Image")
        self._colour = self._advertise("image_raw", "Image")
        self._points = self._advertise("points", "PointCloud2")
        if look is not None:
            self._look = look
            self._pixels = _pixel_directions()
            self._rays = _unit_vectors(self._pixels)
            self.create_timer(PERIOD_NS, self._shoot, phase_ns=_PHASE_NS)

    def _advertise(self, topic: str, msgtype: str) -> Any:
        return self.create_publisher(
            f"sensor_msgs/msg/{msgtype}", f"/intel_realsense_r200_depth/{topic}", qos.RELIABLE
        )

    def _shoot(self) -> None:
        stamped = header(self.now_ns, FRAME)
        for info in (self._colour_info, self._depth_info):
            if info.has_receiver():
                info.publish(camera_info(stamped))
        if not any(p.has_receiver() for p in (self._colour, self._depth, self._points)):
            return
        view = self._look(self._rays, _FAR_M)
        # Along the optical axis, not along the ray.
        depth = in_depth_range(view.distances * self._rays[:, 0])
        if self._colour.has_receiver():
            self._colour.publish(_image(stamped, "rgb8", view.colours))
        if self._depth.has_receiver():
            self._depth.publish(_image(stamped, "32FC1", depth))
        if self._points.has_receiver():
            self._points.publish(_point_cloud(stamped, self._pixels, depth, view.colours))


def add_depth_camera(domain: Domain, world: World, *, renders: bool) -> None:
    """Add the camera to a domain; without ``renders`` it advertises, but publishes nothing."""
    by_name = {mount.child: mount for mount in frames.STATIC}
    camera, link, base = (by_name[name].xyz for name in (FRAME, "camera_link", "base_link"))
    x, y, height = (sum(offsets) for offsets in zip(camera, link, base, strict=True))
    mount = Pose2D(x, y)
    _DepthCamera(
        domain,
        (lambda rays, range_max: world.look(mount, height, rays, range_max)) if renders else None,
    )


def _pixel_directions() -> NDArray[np.float64]:
    """Return each pixel's centre at unit depth, row by row: x right, y down, z = 1."""
    u = (np.arange(WIDTH) - (WIDTH - 1) / 2.0) / FOCAL_LENGTH
    v = (np.arange(HEIGHT) - (HEIGHT - 1) / 2.0) / FOCAL_LENGTH
    x, y = np.meshgrid(u, v)
    return np.column_stack([x.ravel(), y.ravel(), np.ones(WIDTH * HEIGHT)])


def _unit_vectors(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return optical directions as unit vectors, x forward, y left, z up."""
    x, y, z = (pixels / np.linalg.norm(pixels, axis=1, keepdims=True)).T
    return np.column_stack([z, -x, -y])


def in_depth_range(depth: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return depths as the sensor reports them (REP 117): -inf too near, inf too far [m]."""
    reported = np.where(depth < MAX_DEPTH_M, depth, np.inf)
    return np.where(depth > MIN_DEPTH_M, reported, -np.inf).astype(np.float32)


def camera_info(stamped: Any) -> Any:
    """Return the calibration: a pinhole without distortion, centred as in the driver."""
    f, cx, cy = FOCAL_LENGTH, (WIDTH + 1) / 2.0, (HEIGHT + 1) / 2.0
    return _CameraInfo(
        stamped,
        HEIGHT,
        WIDTH,
        "plumb_bob",
        np.zeros(5),
        np.array([f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0]),
        np.eye(3).ravel(),
        np.array([f, 0.0, cx, -f * BASELINE_M, 0.0, f, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
        0,
        0,
        _RegionOfInterest(0, 0, 0, 0, False),
    )


def _image(stamped: Any, encoding: str, pixels: NDArray[Any]) -> Any:
    data = pixels.view(np.uint8).ravel()
    return _Image(stamped, HEIGHT, WIDTH, encoding, 0, len(data) // HEIGHT, data)


def _point_cloud(
    stamped: Any,
    pixels: NDArray[np.float64],
    depth: NDArray[np.float32],
    colours: NDArray[np.uint8],
) -> Any:
    """Return the points in the order of the pixels; out of range, x, y and z are the depth."""
    record = np.zeros((len(depth), _POINT_STEP // 4), np.float32)
    record[:, :3] = np.where(np.isfinite(depth)[:, None], pixels * depth[:, None], depth[:, None])
    rgb = colours.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    record[:, 4] = rgb.view(np.float32)
    return _PointCloud2(
        stamped,
        HEIGHT,
        WIDTH,
        [_PointField(name, offset, _FLOAT32, 1) for name, offset in _POINT_FIELDS],
        False,
        _POINT_STEP,
        WIDTH * _POINT_STEP,
        record.view(np.uint8).ravel(),
        bool(np.isfinite(depth).all()),
    )
