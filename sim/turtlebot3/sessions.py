"""A session, like a day in the laboratory: the conditions that differ between sessions.

The ranges and their reasons are in docs/explanation/testbed.md.
"""

import numpy as np
from scipy import ndimage

from sim.middleware.delays import Load
from sim.middleware.geometry import Pose2D
from sim.nav2.map_server import OccupancyMap
from sim.seeds import SESSION, generator
from sim.turtlebot3.map import FREE, OCCUPIED
from sim.turtlebot3.recipes import Session
from sim.turtlebot3.sensors import GyroError, LidarNoise, SensorErrors

_MAP = 1  # branch of a session's seed for the errors of its map


def draw_session(seed: int, index: int) -> Session:
    """Draw the conditions of a session."""
    rng = generator(seed, SESSION, index)
    return Session(
        index=index,
        lidar_bias_m=rng.uniform(-0.01, 0.01), lidar_noise_m=rng.uniform(0.008, 0.015),
        friction=rng.uniform(0.8, 1.2), mass=rng.uniform(0.9, 1.1),
        latency_ms=rng.uniform(1.0, 8.0), lidar_tom_bias_m=rng.uniform(-0.01, 0.01),
        lidar_dropouts=rng.uniform(0.0, 0.01), latency_jitter_ms=rng.uniform(0.0, 2.0),
        processor_load=rng.uniform(0.0, 0.3), wheel_left=rng.uniform(0.995, 1.005),
        wheel_right=rng.uniform(0.995, 1.005), gyro_bias_rad_s=rng.uniform(-0.005, 0.005),
        gyro_scale=rng.uniform(0.994, 1.006), map_errors=rng.uniform(0.0, 0.03),
        start_sd_m=rng.uniform(0.0, 0.03), start_sd_rad=rng.uniform(0.0, 0.05),
    )  # fmt: skip


def sensor_errors(session: Session) -> SensorErrors:
    """Return the errors of a session's sensors."""
    noise, dropouts = session.lidar_noise_m, session.lidar_dropouts
    return SensorErrors(
        LidarNoise(noise, session.lidar_bias_m, dropouts),
        LidarNoise(noise, session.lidar_tom_bias_m, dropouts),
        GyroError(session.gyro_bias_rad_s, session.gyro_scale),
    )


def load(session: Session) -> Load:
    """Return the delays of a session's messages."""
    return Load(session.latency_jitter_ms, session.processor_load)


def mapped(world: OccupancyMap, seed: int, session: Session) -> OccupancyMap:
    """Return a map with the errors of the session's SLAM.

    A share of the cells of walls is free, and the same share of the free cells beside walls is
    occupied.
    """
    rng = generator(seed, SESSION, session.index, _MAP)
    occupied = world.data == OCCUPIED
    wrong = rng.random(occupied.shape) < session.map_errors
    data = world.data.copy()
    beside = ndimage.binary_dilation(occupied, [[0, 1, 0], [1, 0, 1], [0, 1, 0]])
    data[wrong & (world.data == FREE) & beside] = OCCUPIED
    data[wrong & occupied] = FREE
    return OccupancyMap(data, world.resolution, world.origin)


def estimated_start(start: Pose2D, session: Session, rng: np.random.Generator) -> Pose2D:
    """Return the initial pose that localisation gets, with the error of a manual placement."""
    x, y, yaw = rng.standard_normal(3).tolist()
    place, turn = session.start_sd_m, session.start_sd_rad
    return Pose2D(start.x + place * x, start.y + place * y, start.yaw + turn * yaw)
