import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.features.engine.plugin import Series
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.geometry.scan_matching import along_arc, steps
from oracle_pipeline.features.geometry.scans import RecordedScans, Scans
from oracle_pipeline.features.geometry.transform_tree import SensorMount
from tests.oracle_pipeline.features.scenery import RANGE_MAX_M, RAYS, Pose, World

ROOM = World(((1.0, 0.7, 0.2), (-1.2, 0.4, 0.3), (0.2, -1.4, 0.15)))
BEARINGS = np.arange(RAYS) * 2.0 * np.pi / RAYS


def looked(*poses: Pose, mount: PlanarPose, noise_m: float = 0.0, step_s: float = 0.4) -> Scans:
    """Scans of a base at some poses, its scanner mounted so."""
    rng = np.random.default_rng(0)
    rows = []
    for place, yaw in poses:
        sensor = PlanarPose(np.asarray(place), np.exp(1j * np.asarray(yaw))).compose(mount)
        rays = np.exp(1j * BEARINGS)
        directions = np.angle(sensor.rotation * (rays.conj() if sensor.mirrored else rays))
        rows.append(ROOM.cast(complex(sensor.translation), directions))
    ranges = np.array(rows) + noise_m * rng.standard_normal((len(rows), RAYS))
    stamps_s = np.arange(len(poses)) * step_s
    column = np.ones((len(poses), 1))
    increment = 2.0 * np.pi / RAYS
    return Scans(stamps_s, stamps_s, "laser", 0.0 * column, increment * column, RANGE_MAX_M, ranges)


def mounted(shift: complex = 0j, yaw: float = 0.0, *, flipped: bool = False) -> PlanarPose:
    return PlanarPose(np.asarray(shift), np.exp(1j * np.asarray(yaw)), flipped)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-0.12, 0.12), st.floats(-0.05, 0.05), st.floats(-0.5, 0.5),
    st.floats(-0.2, 0.2), st.floats(-3.0, 3.0), st.booleans(),
)  # fmt: skip
def test_the_motion_of_the_base_is_found_wherever_the_scanner_is(ahead, aside, turn, x, yaw, flip):
    mount = mounted(complex(x, 0.05), yaw, flipped=flip)
    found = steps(
        looked((0j, 0.3), (complex(ahead, aside) * np.exp(0.3j), 0.3 + turn), mount=mount),
        SensorMount("base", mount),
    )
    assert found.turned == pytest.approx([turn], abs=3e-3)
    expected = complex(ahead, aside) * along_arc(np.array([turn]))[0]
    assert abs(found.travelled[0] - expected) < 6e-3


def test_noise_of_a_centimetre_costs_millimetres():
    poses = [(complex(0.1 * i - 0.9, 0.0), 0.1 * i) for i in range(15)]
    found = steps(looked(*poses, mount=mounted(), noise_m=0.01), SensorMount("base", mounted()))
    assert np.abs(found.turned - 0.1).max() < 0.01
    assert np.abs(np.abs(found.travelled) - 0.1).mean() < 5e-3


def test_a_scan_in_which_nothing_returns_matches_nothing():
    scans = looked((0j, 0.0), (0.1 + 0j, 0.0), mount=mounted())
    scans.ranges[1] = np.inf
    found = steps(scans, SensorMount("base", mounted()))
    assert np.isnan(found.turned).all()
    assert np.isnan(found.travelled).all()


def test_scans_too_far_apart_or_too_close_are_not_matched():
    poses = [(0j, 0.0)] * 4
    assert (
        len(steps(looked(*poses, mount=mounted(), step_s=2.0), SensorMount("b", mounted())).to_s)
        == 0
    )
    close = steps(looked(*poses, mount=mounted(), step_s=0.2), SensorMount("b", mounted()))
    assert close.to_s == pytest.approx([0.4])
    assert len(steps(looked(*poses, mount=mounted()), SensorMount("b", None)).to_s) == 3


def test_the_way_along_an_arc_is_longer_than_its_chord():
    quarter = np.array([np.pi / 2])
    chord = np.sqrt(2.0) * np.exp(0.25j * np.pi)  # of a unit circle, seen from where it begins
    assert chord * along_arc(quarter)[0] == pytest.approx(np.pi / 2)


def turning(start: float, increment: float) -> RecordedScans:
    values = [(stamp_s, "laser", start, increment, 3.5, np.ones(8)) for stamp_s in (0.0, 0.4)]
    return RecordedScans(Series(np.array([0.0, 0.4]), values))


@given(st.floats(), st.floats() | st.floats(-1e-5, 1e-5))
def test_a_circle_can_be_counted_in_rays_that_have_bearings(start, increment):
    if turning(start, increment).have_bearings():
        assert np.isfinite(start)
        assert 2.0 <= 2.0 * np.pi / abs(increment) < 2**31


@given(st.floats(-np.pi, np.pi), st.floats(1e-4, 0.5), st.sampled_from([-1.0, 1.0]))
def test_the_rays_of_usual_scanners_have_bearings(start, step, sense):
    assert turning(start, sense * step).have_bearings()
