from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.features.lidar import scan
from tests.oracle_pipeline.features.scenery import (
    Scanner,
    World,
    driving,
    extract,
    recording,
    turning,
)

PLUGINS = scan.register_features()
SCANNER = Scanner("/scan", world=World(((1.0, 0.5, 0.2),)))


@pytest.fixture
def extracted(tmp_path_factory):
    """Return a function from messages to values, where they are, and what is missing."""
    return lambda recorded: extract(PLUGINS, recorded, tmp_path_factory.mktemp("bag"))


def test_roughness_is_the_second_difference_over_the_range():
    # abs(1 - 4 + 4) / 2 = 0.5 and abs(2 - 8 + 6) / 4 = 0.
    assert scan.roughness(np.array([[1.0, 2.0, 4.0, 6.0]])) == pytest.approx(0.25)


@given(st.floats(0.5, 5.0), st.floats(-0.01, 0.01))
def test_a_ramp_is_not_rough(start, slope):
    ramp = start + slope * np.arange(20)
    assert scan.roughness(ramp[np.newaxis]) == pytest.approx(0.0, abs=1e-9)


def test_rays_without_a_return_are_not_rough():
    assert scan.roughness(np.array([[1.0, 1.0, np.inf, 1.0, 1.0, 1.0]])) == pytest.approx(0.0)
    assert np.isnan(scan.roughness(np.array([[1.0, np.inf, 1.0, np.nan]])))


def test_whiteness_of_a_wave_and_of_noise():
    wave = 0.1 * np.sin(np.linspace(0.0, 40.0 * np.pi, 4000))
    noise = np.random.default_rng(1).normal(0.0, 0.05, 4000)
    smooth, white = scan.whiteness(np.stack([wave, noise]))
    assert smooth == pytest.approx(0.0, abs=0.01)
    assert white == pytest.approx(1.0, abs=0.08)
    assert scan.whiteness(np.tile([0.1, -0.1], 50)[np.newaxis]) == pytest.approx(2.0, abs=0.03)


def test_edges_do_not_count_in_whiteness():
    noise = np.random.default_rng(2).normal(0.0, 0.05, 4000)
    edged = noise.copy()
    edged[::50] = 3.0
    assert scan.whiteness(edged[np.newaxis]) == pytest.approx(
        scan.whiteness(noise[np.newaxis]), abs=0.1
    )


@pytest.mark.parametrize("motion", [turning, driving])
def test_motion_is_taken_out_of_the_innovation(extracted, motion):
    values, *_ = extracted(recording([SCANNER], motion))
    assert values["innovation"] < 0.01


def test_noise_is_in_all_three(extracted):
    quiet, *_ = extracted(recording([replace(SCANNER, noise=0.005)], driving))
    noisy, where, _ = extracted(
        recording([replace(SCANNER, noise=0.005), Scanner("/noisy", noise=0.1)], driving)
    )
    assert noisy["roughness"] > 5.0 * quiet["roughness"]
    assert noisy["innovation"] > 2.0 * quiet["innovation"]
    assert noisy["innovation_whiteness"] > quiet["innovation_whiteness"]
    assert where["roughness"] == where["innovation"] == "/noisy"


def test_without_odometry_there_is_roughness_alone(extracted):
    values, _, missing = extracted(recording([SCANNER], odometry=False))
    assert values["roughness"] < 0.05
    assert missing.keys() == {"innovation", "innovation_whiteness"}
