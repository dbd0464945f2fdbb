import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.features.lidar import scan_noise
from oracle_pipeline.features.lidar.scan_noise import uneven
from tests.oracle_pipeline.features.scenery import (
    Scanner,
    World,
    driving,
    extract,
    recording,
    still,
)

PLUGINS = scan_noise.register_features()
SCANNER = Scanner("/scan", world=World(((1.0, 0.7, 0.2),)), noise=0.01)


@pytest.fixture
def extracted(tmp_path_factory):
    """Return a function from messages to values, where they are, and what is missing."""
    return lambda recorded: extract(PLUGINS, recorded, tmp_path_factory.mktemp("bag"))


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 0.02))
def test_even_noise_is_neither_smooth_nor_rough_whatever_its_size(seed, deviation):
    ranges = 2.0 + deviation * np.random.default_rng(seed).standard_normal(360)
    smooth, short, rough = uneven(ranges)
    assert smooth < 0.03
    assert short < 0.06
    assert rough < 0.03


def test_a_stretch_without_noise_is_smooth_and_one_with_more_is_rough():
    rng = np.random.default_rng(3)
    ranges = 2.0 + 0.01 * rng.standard_normal(360)
    smooth, rough = ranges.copy(), ranges.copy()
    smooth[100:130] = 1.0 + 0.001 * np.arange(30)
    rough[100:130] += 0.03 * (-1.0) ** np.arange(30)
    assert uneven(ranges)[0] == 0.0
    assert min(uneven(smooth)[:2]) > 0.05
    assert uneven(rough)[2] > uneven(ranges)[2] + 0.05


def test_a_scan_without_neighbouring_returns_has_no_value():
    assert np.isnan(uneven(np.where(np.arange(100) % 3, np.inf, 1.0))).all()


def test_repeated_scans_are_detected(extracted):
    recorded = recording([SCANNER], driving, 8.0)
    before, *_ = extracted(recorded)
    scans = [message for _, topic, message in recorded if topic == "/scan"]
    for scan, earlier in zip(scans[20:], scans, strict=False):
        scan.ranges = earlier.ranges
    after, where, _ = extracted(recorded)
    assert before["repeated"] == 0.0
    assert after["repeated"] == pytest.approx(0.5)
    assert where["repeated"] == "/scan"


def test_noise_is_measured_while_the_robot_stands(extracted):
    quiet, *_ = extracted(recording([SCANNER], still))
    loud, *_ = extracted(recording([SCANNER, Scanner("/loud", noise=0.05)], still))
    # Uniform noise of 1 % of about 2.3 m; the median of the rays' ranges lies in between.
    assert 0.01 < quiet["still_noise_max"] < 0.02
    assert quiet["still_noise_min"] == quiet["still_noise_max"] == loud["still_noise_min"]
    assert loud["still_noise_max"] > 4.0 * quiet["still_noise_max"]


def test_noise_is_not_measured_while_the_robot_drives(extracted):
    _, _, missing = extracted(recording([SCANNER], driving))
    assert missing["still_noise_max"] == "the robot did not stand still between two scans"
