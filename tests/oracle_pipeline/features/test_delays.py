import numpy as np
import pytest

from oracle_pipeline.bags.types import message_class
from oracle_pipeline.features.traffic import delays
from tests.oracle_pipeline.features.scenery import (
    Scanner,
    driving,
    extract,
    header,
    quaternion,
    recording,
)

PLUGINS = delays.register_features()


@pytest.fixture
def extracted(tmp_path_factory):
    """Return a function from messages to values, where they are, and what is missing."""
    return lambda recorded: extract(PLUGINS, recorded, tmp_path_factory.mktemp("bag"))


def late(recorded, topic, late_s):
    """Record a topic's messages later than they are stamped; by a number or one for each."""
    number, shifted = 0, []
    for time_s, name, message in recorded:
        by_s = 0.0
        if name == topic:
            by_s = late_s if isinstance(late_s, float) else late_s[number % len(late_s)]
            number += 1
        shifted.append((time_s + by_s, name, message))
    return sorted(shifted, key=lambda each: each[0])


def test_sensors_that_are_recorded_as_they_measure_have_no_latency(extracted):
    values, *_ = extracted(recording([Scanner("/scan")], driving))
    for name in ("scan_latency", "odometry_latency", "scan_jitter", "odometry_jitter", "late"):
        assert values[name] == pytest.approx(0.0, abs=1e-6), name


def test_a_sensor_that_is_held_back_is_later_than_the_freshest(extracted):
    recorded = recording([Scanner("/scan"), Scanner("/held")], driving)
    values, where, _ = extracted(late(recorded, "/held", 0.15))
    assert values["scan_latency"] == pytest.approx(0.15, abs=1e-6)
    assert where["scan_latency"] == "/held"
    assert values["odometry_latency"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("stamp_s", [0, 123])
def test_stamps_that_are_not_set_or_of_another_clock_are_not_compared(extracted, stamp_s):
    recorded = recording([Scanner("/scan"), Scanner("/other")], driving)
    for time_s, topic, message in recorded:
        if topic == "/other":
            message.header.stamp.sec = stamp_s + int(time_s) * (stamp_s > 0)
        elif hasattr(message, "header"):
            message.header.stamp.sec += 1_700_000_000
    values, where, _ = extracted(recorded)
    assert values["scan_latency"] == pytest.approx(0.0, abs=1e-6)
    assert where["scan_latency"] == "/scan"
    assert values["late"] == pytest.approx(0.0, abs=1e-6)


def test_a_recorder_that_writes_now_and_then_makes_no_message_late(extracted):
    recorded = recording([Scanner("/scan")], driving)
    times_s = np.arange(0.0, 5.0, 0.005)
    imu = message_class("sensor_msgs/msg/Imu")
    zero, nine = message_class("geometry_msgs/msg/Vector3")(0.0, 0.0, 0.0), np.zeros(9)
    recorded += [
        (t, "/imu", imu(header(t, "imu"), quaternion(0.0), nine, zero, nine, zero, nine))
        for t in times_s.tolist()
    ]
    written = [(np.ceil(t / 0.02) * 0.02, *rest) for t, *rest in recorded]
    values, *_ = extracted(sorted(written, key=lambda each: each[0]))
    assert values["late"] == 0.0


def test_uneven_delays_are_jitter_and_long_ones_late(extracted):
    recorded = late(recording([Scanner("/scan")], driving), "/scan", [0.0, 0.0, 0.1, 0.1, 0.25])
    values, *_ = extracted(recorded)
    assert values["scan_jitter"] == pytest.approx(0.1, abs=0.02)
    assert values["late"] == pytest.approx(0.0, abs=1e-6)
    late_ones, *_ = extracted(
        late(recording([Scanner("/scan")], driving), "/scan", [0.0] * 9 + [0.3])
    )
    assert late_ones["late"] == pytest.approx(0.1, abs=0.02)


def test_a_recorder_whose_clock_runs_faster_changes_little(extracted):
    slow = [(2.0 * time_s, *rest) for time_s, *rest in recording([Scanner("/scan")], driving)]
    values, *_ = extracted(slow)
    assert values["scan_jitter"] < 0.01
    assert values["scan_latency"] < 0.3


def test_stamps_that_are_uneven_show(extracted):
    recorded = recording([Scanner("/scan")], driving)
    rng = np.random.default_rng(0)
    for _, topic, message in recorded:
        if topic == "/scan":
            message.header.stamp.nanosec = int(
                np.clip(message.header.stamp.nanosec + rng.integers(0, 10**8), 0, 10**9 - 1)
            )
    values, where, _ = extracted(recorded)
    assert values["period_jitter"] > 0.05
    assert where["period_jitter"] == "/scan"
