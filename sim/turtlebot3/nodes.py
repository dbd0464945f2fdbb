"""Adds the nodes of the simulator and of the robot to the graph.

Each node gets one measurement of the world and nothing else.
"""

from collections.abc import Callable

import numpy as np

from sim.campaigns import OdometrySource
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND
from sim.middleware.geometry import Pose2D
from sim.middleware.node import Node
from sim.turtlebot3 import frames
from sim.turtlebot3.clock import Gazebo
from sim.turtlebot3.drive import DiffDrivePlugin, JointStatePlugin
from sim.turtlebot3.robot_state import RobotStatePublisher
from sim.turtlebot3.sensors import ImuPlugin, LaserPlugin, RangePlugin, SensorErrors, View
from sim.turtlebot3.wheel_odometry import WheelOdometry
from sim.turtlebot3.world import World

_CAMERA_TOPICS = (
    ("camera_info", "CameraInfo"),
    ("depth/camera_info", "CameraInfo"),
    ("depth/image_raw", "Image"),
    ("image_raw", "Image"),
    ("points", "PointCloud2"),
)


def add_robot(
    domain: Domain,
    world: World,
    errors: SensorErrors,
    generator: Callable[[str], np.random.Generator],
    *,
    odometry_source: OdometrySource = "world",
) -> None:
    """Add the nodes of the simulator and of the robot to a domain.

    Parameters
    ----------
    domain, world
        The graph, and the physics that its measurements come from.
    errors
        Errors of its sensors.
    generator
        Gives each node, by name, its randomness.
    odometry_source
        ``world``: odometry is the ground truth; ``encoder``: it is integrated from the wheels.
    """
    Gazebo(domain)
    # The LiDARs and the infrared are separate devices: each measures at a phase of its own.
    lidars = (
        ("/turtlebot3_laserscan", "/scan", frames.BASE_SCAN, errors.scan, 200),
        ("/turtlebot3_laserscan_tom", "/scan_tom", frames.BASE_SCAN_TOM, errors.scan_tom, 260),
    )
    for name, topic, mount, noise, phase_ms in lidars:
        LaserPlugin(
            domain, name, topic, mount, _rays(world, mount), noise, generator(name),
            phase_ms * MILLISECOND,
        )  # fmt: skip
    RangePlugin(
        domain,
        _rays(world, frames.RANGE_ELLA),
        generator("/turtlebot3_range_ella"),
        330 * MILLISECOND,
    )
    DiffDrivePlugin(
        domain,
        WheelOdometry(world.wheel_states)
        if odometry_source == "encoder"
        else lambda: (world.pose, world.twist),
        world.command_wheels,
    )
    # After the diff drive, so that it measures the effect of the newest command.
    ImuPlugin(domain, world.imu, errors.gyro, generator("/turtlebot3_imu"))
    JointStatePlugin(domain, world.wheel_states)
    _add_depth_camera(domain)
    RobotStatePublisher(domain)


def _rays(world: World, mount: frames.Mount) -> View:
    """Return a sensor's view of the world: ranges along bearings of its own frame."""
    x, y, z = mount.xyz
    pose, height = Pose2D(x, y), z + frames.STATIC[0].xyz[2]
    return lambda bearings, range_max: world.scan(pose, height, bearings, range_max)


def _add_depth_camera(domain: Domain) -> None:
    """Add Gazebo's driver of the r200; without a rendering context it publishes nothing."""
    node = Node(domain, "/intel_realsense_r200_depth_driver")
    for topic, msgtype in _CAMERA_TOPICS:
        node.create_publisher(
            f"sensor_msgs/msg/{msgtype}", f"/intel_realsense_r200_depth/{topic}", qos.RELIABLE
        )
