"""A robot whose odometry is a message and a transform, and whose localisation is both as well."""

from typing import Any

import numpy as np
import pytest

from oracle_pipeline.bags.types import message_class
from oracle_pipeline.features.motion import transforms
from tests.oracle_pipeline.features.scenery import (
    believed_message,
    driving,
    extract,
    header,
    odometry_message,
    quaternion,
)

PLUGINS = transforms.register_features()
CORRECTION = 0.3 + 0.2j, 0.4  # of the odometry frame in the map


def transform(time_s: float, parent: str, child: str, place: complex, yaw: float) -> Any:
    vector = message_class("geometry_msgs/msg/Vector3")(place.real, place.imag, 0.0)
    stamped = message_class("geometry_msgs/msg/TransformStamped")(
        header(time_s, parent), child,
        message_class("geometry_msgs/msg/Transform")(vector, quaternion(yaw)),
    )  # fmt: skip
    return message_class("tf2_msgs/msg/TFMessage")([stamped])


def robot(*, tf: complex = 0j, pose: complex = 0j, jump: complex = 0j) -> list[Any]:
    """Messages of 6 s; transform, localisation or, from 3 s on, odometry are off by so much."""
    recorded = []
    shift, turn = CORRECTION
    for step in range(120):
        time_s = step / 20
        place, yaw = driving(time_s)
        place += jump if time_s >= 3.0 else 0j
        recorded += [
            (time_s, "/odom", odometry_message(time_s, place, yaw)),
            (time_s, "/tf", transform(time_s, "odom", "base", place + tf, yaw)),
        ]
        if step % 10 == 0:
            believed = shift + np.exp(1j * turn) * (place + tf) + pose
            recorded += [
                (time_s, "/tf", transform(time_s + 1.0, "map", "odom", shift, turn)),
                (time_s, "/pose", believed_message(time_s, believed, yaw + turn)),
            ]
    return recorded


@pytest.fixture
def extracted(tmp_path_factory):
    """Return a function from what is off to values, where they are, and what is missing."""
    return lambda **off: extract(PLUGINS, robot(**off), tmp_path_factory.mktemp("bag"))


def test_consistent_poses_have_no_difference(extracted):
    values, where, missing = extracted()
    assert missing == {}
    for name in (f"{a}_{b}" for a in ("odometry", "localisation") for b in ("position", "yaw")):
        assert values[name] == pytest.approx(0.0, abs=1e-9), name
    assert where["odometry_position"] == "/odom against odom -> base"
    assert where["localisation_position"] == "/pose against map -> odom -> base"


def test_a_shift_of_five_centimetres_is_measured_as_such(extracted):
    values, *_ = extracted(tf=0.05)
    assert values["odometry_position"] == pytest.approx(0.05)
    assert values["localisation_position"] == pytest.approx(0.0, abs=1e-9)
    values, *_ = extracted(pose=0.05j)
    assert values["odometry_position"] == pytest.approx(0.0, abs=1e-9)
    assert values["localisation_position"] == pytest.approx(0.05)


def test_a_latched_pose_of_before_the_recording_is_not_compared(tmp_path):
    latched = (0.0, "/pose", believed_message(-30.0, 5.0 + 0j, 2.0))
    values, *_ = extract(PLUGINS, [latched, *robot()], tmp_path)
    assert values["localisation_position"] == pytest.approx(0.0, abs=1e-9)
    assert values["localisation_yaw"] == pytest.approx(0.0, abs=1e-9)


def test_odometry_that_jumps_is_far_from_its_neighbours(extracted):
    smooth, *_ = extracted()
    jumped, *_ = extracted(jump=0.05j)
    assert smooth["odometry_jump"] < 2e-3
    assert jumped["odometry_jump"] == pytest.approx(0.025, abs=2e-3)


def test_a_robot_without_transforms_reports_what_is_missing(tmp_path):
    kept = [message for message in robot() if message[1] == "/odom"]
    values, _, missing = extract(PLUGINS, kept, tmp_path)
    assert values["odometry_jump"] < 2e-3
    assert missing["odometry_position"] == "no odometry with a transform between the same frames"
