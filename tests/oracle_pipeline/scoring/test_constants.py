import numpy as np
import pytest

from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.scoring.constants import MOST_MESSAGES, constants
from oracle_pipeline.scoring.pace import FEWEST
from tests.oracle_pipeline.features.conftest import write_bag
from tests.oracle_pipeline.features.scenery import odometry_message, scan_message


def scans(count, alter=None):
    made = []
    for number in range(count):
        message = scan_message(number, "laser", np.full(8, 1.0 + number))
        if alter:
            alter(message, number)
        made.append((float(number), "/scan", message))
    return made


@pytest.fixture
def constants_of(tmp_path):
    def read(recorded):
        write_bag(tmp_path / "robot", recorded)
        with BagReader(tmp_path / "robot") as bag:
            return constants(bag)

    return read


def test_fixed_parameters_of_a_sensor_are_constants_and_measurements_are_not(constants_of):
    driven = [(float(i), "/odom", odometry_message(i, 0.1j * i, 0.0)) for i in range(FEWEST)]
    found = constants_of(scans(FEWEST) + driven)
    assert found["/scan"]["header.frame_id"] == "'laser'"
    assert not {"ranges", "header.stamp.sec"} & found["/scan"].keys()
    assert found["/odom"]["pose.pose.position.x"] == "0"
    assert found["/odom"]["pose.covariance"] == f"[{', '.join(['0'] * 36)}]"
    assert "pose.pose.position.y" not in found["/odom"]


def test_a_topic_with_few_messages_has_no_constants(constants_of):
    assert constants_of(scans(FEWEST - 1)) == {}


@pytest.mark.parametrize("value", [3.0, np.nan, np.inf])
def test_a_lasting_change_is_detected_in_a_long_recording(constants_of, value):
    def alter(message, number):
        if number >= 4 * MOST_MESSAGES:
            message.range_max = value

    found = constants_of(scans(5 * MOST_MESSAGES, alter))["/scan"]
    assert "range_max" not in found
    assert "range_min" in found


def test_a_field_that_is_always_nan_is_constant(constants_of):
    def alter(message, _number):
        message.range_max = np.nan

    assert constants_of(scans(FEWEST, alter))["/scan"]["range_max"] == "nan"
