"""Drives of a small robot as exported topics, with noise, and with a fault if one is given."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

AT_S = 8.0  # when faults begin
DURATION_S = 20.0

Tables = dict[str, pd.DataFrame]  # by topic


def sound_drive(folder: Path, seed: int) -> Path:
    """Write a drive without any fault."""
    return drive(folder, lambda _: None, seed)


def drive(folder: Path, alter: Callable[[Tables], None], seed: int = 0) -> Path:
    """Write a drive whose tables were altered."""
    tables = _tables(np.random.default_rng(seed))
    alter(tables)
    path = folder / "drive" if folder.exists() else folder
    path.mkdir(parents=True)
    for name, table in tables.items():
        table.to_csv(path / f"{name}.csv", index=False)
    return path


def _tables(rng: np.random.Generator) -> Tables:
    imu_s, odometry_s, gps_s = (np.arange(0.0, DURATION_S, 1.0 / rate) for rate in (100, 20, 10))
    turning = 0.3 * np.sin(0.5 * imu_s)
    imu = {"Time": imu_s} | _rotation("orientation", 0.6 * (1.0 - np.cos(0.5 * imu_s)))
    imu |= {f"angular_velocity.{axis}": rng.normal(0.0, 0.01, len(imu_s)) for axis in "xyz"}
    imu["angular_velocity.z"] = imu["angular_velocity.z"] + turning
    imu |= {f"linear_acceleration.{axis}": rng.normal(0.0, 0.1, len(imu_s)) for axis in "xyz"}
    speed = 0.5 + rng.normal(0.0, 0.01, len(odometry_s))
    odometry = {"Time": odometry_s, "header.stamp.sec": 100 + np.floor(odometry_s)}
    odometry |= {"header.stamp.nanosec": np.round(np.mod(odometry_s, 1.0) * 1e9)}
    for axis in "xyz":
        odometry[f"pose.pose.position.{axis}"] = np.cumsum(speed) / 20.0 * (axis == "x")
    odometry |= _rotation("pose.pose.orientation", np.zeros(len(odometry_s)))
    for axis in "xyz":
        odometry[f"twist.twist.linear.{axis}"] = speed * (axis == "x")
        odometry[f"twist.twist.angular.{axis}"] = rng.normal(0.0, 0.01, len(odometry_s))
    gps = {"Time": gps_s} | {
        name: value + rng.normal(0.0, 1e-7, len(gps_s)) + gps_s * 5e-6
        for name, value in (("latitude", 48.0), ("longitude", 11.0), ("altitude", 500.0))
    }
    status = {"Time": gps_s, "count": np.arange(len(gps_s)), "load": rng.random(len(gps_s))}
    named = {"imu": imu, "odom": odometry, "gps": gps, "status": status}
    return {name: pd.DataFrame(columns) for name, columns in named.items()}


def _rotation(path: str, yaw: np.ndarray) -> dict[str, np.ndarray]:
    zero = np.zeros(len(yaw))
    parts = {"x": zero, "y": zero, "z": np.sin(yaw / 2.0), "w": np.cos(yaw / 2.0)}
    return {f"{path}.{axis}": values for axis, values in parts.items()}
