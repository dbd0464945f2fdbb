"""A robot whose odometry, gyroscope, wheels and scanner measure one motion unless altered."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.cdr import ENCAPSULATION
from oracle_pipeline.bags.types import TypeDefinition, message_class, serialize
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.features.motion import kinematics
from oracle_pipeline.features.motion.kinematics import fit
from tests.oracle_pipeline.features.scenery import (
    RAYS,
    Scanner,
    World,
    extract,
    header,
    odometry_message,
    of_bag,
    quaternion,
    recording,
)

PLUGINS = kinematics.register_features()
SECONDS = 12.0
RADIUS_M, TRACK_M = 0.033, 0.16
SCANNER = Scanner("/scan", x_m=0.05, world=World(((1.0, 0.7, 0.2), (-1.2, 0.4, 0.3))))
TIMES_S = np.arange(0.0, SECONDS, 0.02)


def speeds(time_s: Any) -> tuple[Any, Any]:
    """Forward speed [m/s] and turn rate [rad/s], never constant for long."""
    return 0.15 + 0.1 * np.sin(1.3 * time_s), 0.5 * np.sin(0.9 * time_s)


def poses() -> tuple[np.ndarray, np.ndarray]:
    fine_s = np.arange(0.0, SECONDS + 1.0, 1e-3)
    speed, rate = speeds(fine_s)
    yaw = np.concatenate([[0.0], np.cumsum(rate[:-1]) * 1e-3])
    place = -0.8 + np.concatenate([[0j], np.cumsum(speed[:-1] * np.exp(1j * yaw[:-1])) * 1e-3])
    return place, yaw


PLACE, YAW = poses()


def motion(time_s: float) -> tuple[complex, float]:
    index = round(time_s * 1e3)
    return complex(PLACE[index]), float(YAW[index])


def robot(
    *, odometry: float = 1.0, twist: float = 1.0, gyro: float = 1.0, wheels: float = 1.0,
    rates: float = 1.0, command: float = 1.0, push: float = 0.0, drift: float = 0.0,
    late_s: float = 0.0, scan: float = 1.0, rotated_rays: int = 0, told: float = 1.0,
) -> list[tuple[float, str, Any]]:  # fmt: skip
    """Return all messages; one stream can be multiplied by a factor, or delayed."""
    vector = message_class("geometry_msgs/msg/Vector3")
    recorded = [m for m in recording([SCANNER], motion, SECONDS) if m[1] != "/odom"]
    for _, topic, message in recorded:
        if topic == "/scan":
            message.ranges = np.asarray(
                np.roll(message.ranges * scan, rotated_rays), dtype=np.float32
            )
    forward = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(PLACE)))])
    for time_s in TIMES_S:
        place, yaw = motion(time_s)
        speed, rate = speeds(time_s)
        reported = odometry_message(time_s, odometry * place, yaw)
        reported.twist.twist = message_class("geometry_msgs/msg/Twist")(
            vector(twist * speed, 0.0, 0.0), vector(0.0, 0.0, twist * rate)
        )
        past = motion(max(0.0, time_s - late_s))[1], speeds(max(0.0, time_s - late_s))[1]
        inertial = message_class("sensor_msgs/msg/Imu")(
            header(time_s, "nose"), quaternion(past[0] + drift * time_s), np.zeros(9),
            vector(0.0, 0.0, gyro * past[1]), np.zeros(9), vector(push, 0.0, 9.80665), np.zeros(9),
        )  # fmt: skip
        way = forward[round(time_s * 1e3)]
        angles = wheels * np.array([way - yaw * TRACK_M / 2, way + yaw * TRACK_M / 2]) / RADIUS_M
        spins = wheels * np.array([speed - rate * TRACK_M / 2, speed + rate * TRACK_M / 2])
        joints = message_class("sensor_msgs/msg/JointState")(
            header(time_s, ""), ["left", "right"], angles, rates * spins / RADIUS_M, np.zeros(0)
        )
        pose = odometry_message(time_s, told * place, yaw).pose.pose
        wanted, obeyed = (
            message_class("geometry_msgs/msg/Twist")(
                vector(factor * speed, 0.0, 0.0), vector(0.0, 0.0, factor * rate)
            )
            for factor in (1.0, command)
        )
        recorded += [
            (time_s, "/odometry", reported), (time_s, "/inertia", inertial),
            (time_s, "/joints", joints), (time_s, "/wanted", wanted), (time_s, "/obeyed", obeyed),
            (time_s, "/told", pose), (time_s, "/fix", fix_message(time_s, told * place)),
        ]  # fmt: skip
    return sorted(recorded, key=lambda each: each[0])


def fix_message(time_s: float, place: complex) -> Any:
    """Return what satellites tell of a place, at the equator."""
    metre = np.degrees(1.0 / 6378137.0)
    fix = message_class("sensor_msgs/msg/NavSatFix")
    status = message_class("sensor_msgs/msg/NavSatStatus")(0, 1)
    east, north = place.real * metre, place.imag * metre
    return fix(header(time_s, "gps"), status, north, east, 0.0, np.zeros(9), 0)


@pytest.fixture(scope="module")
def extracted(tmp_path_factory):
    """Return a function from what is altered to values, where they are, and what is missing."""
    return lambda **altered: extract(PLUGINS, robot(**altered), tmp_path_factory.mktemp("bag"))


@pytest.fixture(scope="module")
def honest(extracted):
    return extracted()


def test_streams_of_one_motion_agree(honest):
    values, _, missing = honest
    assert missing == {}
    for pair in kinematics.PAIRS:
        scale = values[pair.column("scale")]
        loose = 0.02 if "scan" in pair or "command" in pair else 3e-3
        if pair.second != "joints" and pair.first != "joints":
            assert scale == pytest.approx(0.0, abs=loose), pair
        assert values[pair.column("lag")] == pytest.approx(0.0, abs=0.02), pair
        assert values[pair.column("residual")] < 0.03, pair
        assert values[pair.column("drift")] == pytest.approx(0.0, abs=2e-3), pair
    assert values["gravity"] == pytest.approx(9.80665)
    assert values["gravity_residual"] == pytest.approx(0.0, abs=1e-9)
    assert values["travel_bearing_pose_twist"] == pytest.approx(0.0, abs=1e-3)
    assert values["travel_bearing_pose_scan"] == pytest.approx(0.0, abs=0.01)


def test_a_scanner_that_is_mounted_askew_travels_in_another_direction(extracted, honest):
    values, *_ = extracted(rotated_rays=3)
    bearing = values["travel_bearing_pose_scan"] - honest[0]["travel_bearing_pose_scan"]
    assert bearing == pytest.approx(3 * 2.0 * np.pi / RAYS, rel=0.2)


def test_the_radius_of_the_wheels_and_their_distance_are_estimated(honest):
    values, *_ = honest
    assert np.exp(-values["travel_scale_pose_joints"]) == pytest.approx(RADIUS_M, rel=2e-3)
    assert np.exp(-values["turn_scale_pose_joints"]) == pytest.approx(
        2.0 * RADIUS_M / TRACK_M, rel=3e-3
    )


@pytest.mark.parametrize(
    ("altered", "larger", "smaller"),
    [
        (
            "odometry",
            ("travel_scale_place_pose",),
            ("travel_scale_pose_twist", "travel_scale_pose_joints"),
        ),
        ("told", (), ("travel_scale_place_pose",)),
        ("twist", ("turn_scale_pose_twist", "travel_scale_pose_twist"), ()),
        ("gyro", ("turn_scale_pose_gyro",), ("turn_scale_gyro_orientation",)),
        ("wheels", ("travel_scale_pose_joints", "turn_scale_gyro_joints"), ()),
        ("rates", ("spin_scale_angles_rates",), ()),
        (
            "command",
            (),
            ("travel_scale_command_pose", "turn_scale_command_pose", "turn_scale_command_gyro"),
        ),
        ("scan", ("travel_scale_pose_scan", "travel_scale_joints_scan"), ()),
    ],
)
def test_five_per_cent_in_one_stream_are_measured_in_its_pairs(
    extracted, honest, altered, larger, smaller
):
    before, *_ = honest
    values, *_ = extracted(**{altered: 1.05})
    for columns, sign in ((larger, 1.0), (smaller, -1.0)):
        for column in columns:
            change = values[column] - before[column]
            assert change == pytest.approx(sign * np.log(1.05), abs=0.012), column


def test_wheels_that_slip_now_and_then_are_off_in_metres_whatever_their_radius(tmp_path):
    steps = 0.004 * np.sin(7.0 * TIMES_S)  # [m]; a slip comes and goes
    residuals = []
    for name, radius in (("small", 1.0), ("large", 5.0)):
        recorded, slipped = robot(wheels=1.0 / radius), iter(steps)
        for _, topic, message in recorded:
            if topic == "/joints":
                message.position = message.position + next(slipped) / RADIUS_M / radius
                message.velocity = np.zeros(0)
        values, *_ = extract(PLUGINS, recorded, tmp_path / name)
        residuals.append(values["travel_residual_pose_joints"])
    assert residuals[0] == pytest.approx(residuals[1], rel=0.05)
    slipped = np.diff(np.interp(np.arange(0.0, SECONDS, 0.4), TIMES_S, steps)) / 0.4
    assert residuals[0] == pytest.approx(np.std(slipped), rel=0.3)


def test_messages_that_arrive_at_once_after_a_stall_turn_no_wheel_back(honest, tmp_path):
    stalled = [(t, topic, m) if not 5.7 < t < 6.5 else (6.5, topic, m) for t, topic, m in robot()]
    values, *_ = extract(PLUGINS, stalled, tmp_path)
    for name in ("spin_drift_angles_rates", "travel_scale_pose_joints"):
        assert values[name] == pytest.approx(honest[0][name], abs=0.1), name


def test_a_gripper_on_the_topic_of_the_wheels_changes_nothing(honest, tmp_path):
    make, none = message_class("sensor_msgs/msg/JointState"), np.zeros(0)
    gripper = make(header(0.0, ""), ["finger"], np.array([0.4]), np.array([0.0]), none)
    mixed = [(time_s, "/joints", gripper) for time_s in np.arange(0.0, SECONDS, 0.25)]
    values, *_ = extract(PLUGINS, sorted(mixed + robot(), key=lambda each: each[0]), tmp_path)
    for name in ("spin_drift_angles_rates", "travel_scale_pose_joints", "turn_scale_gyro_joints"):
        assert values[name] == pytest.approx(honest[0][name], abs=0.01), name


def test_a_stream_that_is_late_lags(extracted):
    values, where, _ = extracted(late_s=0.15)
    assert values["turn_lag_pose_gyro"] == pytest.approx(0.15, abs=0.02)
    assert values["turn_lag_gyro_joints"] == pytest.approx(-0.15, abs=0.02)
    assert where["turn_lag_pose_gyro"] == "/odometry against /inertia"


@pytest.mark.parametrize(
    ("first", "place"), [("gyro", "/inertia"), ("pose", "/odometry against /inertia")]
)
def test_an_orientation_that_drifts_away_from_another_source_drifts(
    extracted, honest, first, place
):
    before, *_ = honest
    values, where, _ = extracted(drift=0.01)
    column = f"turn_drift_{first}_orientation"
    assert values[column] - before[column] == pytest.approx(0.01, rel=0.1)  # some counts as scale
    assert where[column] == place


def test_an_acceleration_that_the_orientation_does_not_explain_is_measured(extracted):
    values, where, _ = extracted(push=0.4)
    assert values["gravity_residual"] == pytest.approx(0.4)
    assert where["gravity_residual"] == "/inertia"


@pytest.mark.parametrize("is_known", [True, False])
def test_a_tilted_imu_has_a_gravity_residual_only_without_its_orientation(tmp_path, is_known):
    tilt, tilted = 0.3, robot()
    half = message_class("geometry_msgs/msg/Quaternion")(
        0.0, np.sin(tilt / 2), 0.0, np.cos(tilt / 2)
    )
    for _, topic, message in tilted:
        if topic == "/inertia":
            message.linear_acceleration.x = -9.80665 * np.sin(tilt)
            message.linear_acceleration.z = 9.80665 * np.cos(tilt)
            message.orientation = half
            if not is_known:
                message.orientation_covariance[0] = -1.0
    values, *_ = extract(PLUGINS, tilted, tmp_path)
    expected = 0.0 if is_known else 9.80665 * 2.0 * np.sin(tilt / 2)
    assert values["gravity_residual"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("source", ["/told", "/fix"])
def test_slipping_wheels_tell_more_than_any_source_of_places(tmp_path, source):
    kept = [m for m in robot(odometry=1.3, twist=1.3) if m[1] in ("/odometry", source)]
    values, where, _ = extract(PLUGINS, kept, tmp_path)
    assert values["travel_scale_place_pose"] == pytest.approx(np.log(1.3), abs=0.01)
    assert where["travel_scale_place_pose"] == f"{source} against /odometry"
    assert values["travel_scale_pose_twist"] == pytest.approx(0.0, abs=0.01)


def test_places_stand_in_for_odometry(tmp_path):
    kept = [m for m in robot(gyro=1.05) if m[1] in ("/told", "/inertia", "/tf_static")]
    values, where, _ = extract(PLUGINS, kept, tmp_path)
    assert values["turn_scale_pose_gyro"] == pytest.approx(np.log(1.05), abs=0.012)
    assert where["turn_scale_pose_gyro"] == "/told against /inertia"


def test_a_car_without_odometry_is_compared_with_its_steering(tmp_path):
    fields = "steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk"
    steering = TypeDefinition("".join(f"float32 {name}\n" for name in fields), "")
    with BagWriter(tmp_path / "robot") as bag:
        bag.add_topic("/drive", "ackermann_msgs/msg/AckermannDrive", [], steering)
        for time_s, topic, message in robot(gyro=1.05, told=1.1):
            at_ns = round(time_s * 1e9)
            if topic == "/wanted":
                speed, rate = message.linear.x, message.angular.z
                drive = np.array([np.arctan2(rate, speed), 0, speed, 0, 0], np.float32)
                bag.write("/drive", at_ns, ENCAPSULATION + drive.tobytes())
            elif topic in ("/inertia", "/fix", "/tf_static"):
                bag.add_topic(topic, message.__msgtype__, [])
                bag.write(topic, at_ns, serialize(message, message.__msgtype__))
    values, where, _ = of_bag(PLUGINS, tmp_path / "robot")
    assert values["turn_scale_command_gyro"] == pytest.approx(np.log(1.05), abs=0.012)
    assert values["travel_scale_command_pose"] == pytest.approx(np.log(1.1), abs=0.012)
    assert where["travel_scale_command_pose"] == "/drive against /fix"


def test_without_odometry_the_others_are_still_compared(tmp_path):
    kept = [m for m in robot(gyro=1.05) if m[1] not in ("/odometry", "/odom", "/told")]
    values, _, missing = extract(PLUGINS, kept, tmp_path)
    assert values["turn_scale_gyro_scan"] == pytest.approx(-np.log(1.05), abs=0.012)
    assert np.isfinite(values["turn_scale_gyro_joints"])
    assert missing["travel_scale_pose_twist"] == "no travel from both pose and twist"


complex_rows = st.lists(
    st.complex_numbers(min_magnitude=0.1, max_magnitude=1.0), min_size=8, max_size=40
)


@given(complex_rows, st.floats(0.5, 2.0), st.floats(-0.3, 0.3), st.integers(0, 2**32 - 1))
def test_scale_and_lag_are_found_whatever_a_few_outliers_say(rows, scale, lag, seed):
    rng = np.random.default_rng(seed)
    first = np.array(rows)
    slope = rng.standard_normal(len(first)) + 1j * rng.standard_normal(len(first))
    second = scale * (first - lag * slope)
    found, late, _ = fit(first, slope, second)
    assert (found, late) == pytest.approx((scale, lag), abs=1e-6)


@given(st.floats(0.5, 0.95), st.floats(0.02, 50.0), st.integers(0, 99))
def test_a_robot_that_stands_most_of_the_time_is_measured_while_it_moves(standing, scale, seed):
    rng = np.random.default_rng(seed)
    moves = np.arange(200) >= 200 * standing
    first = np.where(moves, rng.uniform(0.05, 0.1, 200), rng.normal(0.0, 1e-7, 200)) + 0j
    noise = np.where(moves, 1e-3 * scale, 1e-9) * rng.normal(size=200)
    found, _, kept = fit(first, rng.normal(0.0, 1e-9, 200) + 0j, scale * first + noise)
    assert found == pytest.approx(scale, rel=0.02)
    assert kept[moves].mean() > 0.9
