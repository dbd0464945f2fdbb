from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.features.engine.plugin import Series
from oracle_pipeline.features.geometry.grid_hits import HitCounter
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.geometry.scan_agreement import agreement, contradicted_shares
from oracle_pipeline.features.geometry.scans import Scans
from oracle_pipeline.features.geometry.transform_tree import TransformTree, keep_transforms
from oracle_pipeline.features.lidar import redundancy
from oracle_pipeline.features.statistics.reduction import row_medians
from oracle_pipeline.features.statistics.times import nearest
from tests.oracle_pipeline.features.scenery import (
    ROOM_M,
    Scanner,
    World,
    driving,
    extract,
    frame_of,
    range_message,
    recording,
    scan_message,
    transforms,
    turning,
)

PLUGINS = redundancy.register_features()
FRONT, BACK = Scanner("/front", 0.116, late_s=0.06), Scanner("/back")
# The face that the robot sees, at the origin, lies in one cell of 0.25 m.
DISC = (1.125, 0.125, 0.1)
DISC_SHARE = np.arcsin(0.1 / np.hypot(1.125, 0.125)) / np.pi  # of the rays of a scanner there


@pytest.fixture
def extracted(tmp_path_factory):
    """Return a function from messages to values, where they are, and what is missing."""
    return lambda recorded: extract(PLUGINS, recorded, tmp_path_factory.mktemp("bag"))


def seen(ranges, **changes):
    """One scan of evenly spaced rays around."""
    ranges = np.atleast_2d(np.asarray(ranges, dtype=float))
    count = ranges.shape[1]
    scans = Scans(
        np.zeros(1), np.zeros(1), "", np.zeros((1, 1)), np.full((1, 1), 2 * np.pi / count), 10.0,
        ranges,
    )  # fmt: skip
    return replace(scans, **changes)


@pytest.mark.parametrize("increment", [2 * np.pi / 12, 2 * np.pi / 9, -0.3, 1.0, 7.0, 0.01, 1e-7])
def test_points_agree_as_when_each_is_compared_by_itself(increment):
    """Scans that close, overlap themselves or cover a part; rays without a return or unknown."""
    random = np.random.default_rng(3)
    points = random.normal(0.0, 3.0, (20, 30)) + 1j * random.normal(0.0, 3.0, (20, 30))
    points[random.random(points.shape) < 0.1] = np.nan
    ranges = random.choice([np.nan, np.inf, 1.0, 2.0, 3.0, 4.0], (20, 12))
    ranges[::2] = np.nan_to_num(ranges[::2], nan=2.5, posinf=np.inf)
    bearings = np.full((20, 1), -1.0), np.full((20, 1), increment)
    reference = Scans(np.zeros(20), np.zeros(20), "", *bearings, 10.0, ranges)
    found, circle = agreement(points, reference), max(1, round(2 * np.pi / abs(increment)))
    for i, j in np.ndindex(points.shape):
        own = (
            round((np.angle(points[i, j]) + 1.0) / increment) if points[i, j] == points[i, j] else 0
        )
        rays = (own + np.arange(-2, 3)) % circle
        near = np.array([ranges[i, ray] if ray < 12 else np.nan for ray in rays])
        away = abs(points[i, j]) - near
        known = not np.isnan(away).any()
        finite = np.abs(away[np.isfinite(away)])
        assert found.compared[i, j] == known
        assert found.contradicted[i, j] == (known and abs(points[i, j]) + 0.3 < min(10.0, *near))
        assert found.residual[i, j] == pytest.approx(
            finite.min() if finite.size else np.nan, nan_ok=True
        )
        own_gap = away[2] if np.isfinite(away[2]) else np.nan
        assert found.signed[i, j] == pytest.approx(own_gap, nan_ok=True)
    np.testing.assert_array_equal(
        contradicted_shares(points, reference), found.contradicted_share()
    )


def test_a_point_is_compared_with_the_nearest_of_five_bearings():
    # Eight rays, 45 degrees apart; the point is at bearing 0, 2 m away.
    found = agreement(np.array([[2.0 + 0j]]), seen([5.0, 5.0, 2.1, 5, 5, 5, 5, 5]))
    assert found.residual == pytest.approx(0.1)
    assert found.signed == pytest.approx(-3.0)
    assert not found.contradicted.any()  # another thing is close to that bearing
    assert found.compared.all()


@pytest.mark.parametrize(
    ("around", "contradicted", "compared"),
    [
        ([5.0] * 8, True, True),  # looked through
        ([2.31] * 8, True, True),
        ([2.29] * 8, False, True),  # as near as makes no difference
        ([1.0] * 8, False, True),  # hidden behind something
        ([np.inf] * 8, True, True),  # nothing there (REP 117)
        ([5, 5, np.nan, 5, 5, 5, 5, 5], False, False),  # unknown
    ],
)
def test_a_point_is_contradicted_by_a_scanner_that_measures_behind_it(
    around, contradicted, compared
):
    found = agreement(np.array([[2.0 + 0j]]), seen(around))
    assert found.contradicted.item() == contradicted
    assert found.compared.item() == compared


def test_a_scanner_does_not_contradict_points_outside_its_view():
    point = np.array([[2.0 + 0j]])
    assert not agreement(point, seen([np.inf] * 8, range_max=2.2)).contradicted.any()
    # A scanner of the left half only knows nothing of the right.
    half = seen([5.0] * 8, angle_increment=np.full((1, 1), np.pi / 16))
    assert not agreement(-1j * point, half).compared.any()


poses = st.builds(
    lambda x, y, yaw, flipped: PlanarPose(
        np.asarray(complex(x, y)), np.asarray(np.exp(1j * yaw)), flipped
    ),
    st.floats(-5, 5), st.floats(-5, 5), st.floats(-4, 4), st.booleans(),
)  # fmt: skip


@given(poses, poses)
def test_poses_compose_and_invert(one, other):
    points = np.array([1.0 + 2.0j, -0.5 + 0.1j])
    assert one.compose(other).apply(points) == pytest.approx(one.apply(other.apply(points)))
    assert one.inverse().apply(one.apply(points)) == pytest.approx(points)
    assert one.compose(one.inverse()).apply(points) == pytest.approx(points)


def test_frames_are_connected_up_to_their_root():
    joints = keep_transforms(transforms(("base", "arm", 1.0, False), ("arm", "lidar", 0.5, True)))
    frames = TransformTree({"/tf_static": Series(np.zeros(1), np.fromiter([joints], dtype=object))})
    root, pose = frames.mount("lidar")
    assert root == "base"
    assert pose.mirrored
    assert pose.apply(np.array(1.0 + 1.0j)) == pytest.approx(2.5 - 1.0j)
    assert frames.mount("alone").root == "alone"


def test_cells_are_counted_once_a_scan():
    points = np.array([[0.1 + 0.1j, 0.2 + 0.2j], [0.1 + 0.1j, 0.9 + 0.9j], [0.9 + 0.9j, 0j]])
    chosen = np.array([[True, True], [True, True], [False, False]])
    counter = HitCounter(3)
    for i in range(3):
        counter.add(points[i : i + 1], chosen[i : i + 1], i)
    hits = counter.hits()
    assert hits.persistence(slice(0, 3)) == pytest.approx(2 / 3)
    assert hits.persistence(slice(0, 1)) == 1.0
    assert hits.persistence(slice(2, 3)) == 0.0
    assert np.isnan(hits.persistence(slice(3, 3)))


def test_hits_far_away_on_opposite_sides_are_in_different_cells():
    points = np.array([[1e300 + 0j, -1e300 + 0j, 1e300 + 0j]])
    counter = HitCounter(3)
    counter.add(points, np.ones((1, 3), dtype=np.bool_), 0)
    assert sorted(counter.hits().cells.tolist()) == [0, 1]


def test_cells_beyond_the_limit_are_not_counted_at_all():
    counter = HitCounter(1)
    counter.add(np.array([[0.1 + 0.1j, 0.9 + 0.9j]]), np.array([[True, True]]), 0)
    counter.add(np.array([[0.1 + 0.1j]]), np.array([[True]]), 1)
    assert "MOST_HITS" in counter.hits().reason


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=8, unique=True), st.floats(-9, 9))
def test_nearest_returns_the_nearest_point(times, wanted):
    times = np.sort(times)
    (index,) = nearest(times, np.array([wanted]))
    assert abs(times[index] - wanted) == np.abs(times - wanted).min()


def test_row_medians_leave_nan_out():
    rows = np.array([[3.0, np.nan, 1.0], [4.0, 2.0, 9.0], [np.nan] * 3])
    np.testing.assert_allclose(row_medians(rows), [2.0, 4.0, np.nan])


def test_scanners_of_one_room_agree_while_the_robot_drives(extracted):
    values, *_ = extracted(recording([FRONT, BACK], driving))
    assert values["scan_residual"] < 0.01
    assert values["scan_contradicted"] == 0.0
    assert values["scan_persistence"] == 0.0


def test_a_pass_through_has_no_residual(extracted):
    values, *_ = extracted(recording([BACK, replace(BACK, topic="/copy")]))
    assert values["scan_residual"] == pytest.approx(0.0, abs=1e-6)


def test_a_real_obstacle_is_seen_by_all_and_changes_nothing(extracted):
    world = World((DISC,))
    values, *_ = extracted(
        recording([replace(FRONT, world=world), replace(BACK, world=world)], driving)
    )
    assert values["scan_residual"] < 0.01
    assert values["scan_contradicted"] == 0.0
    assert values["scan_persistence"] == 0.0


@pytest.mark.parametrize(("cheated", "honest"), [("/back", "/front"), ("/front", "/back")])
def test_a_fake_object_is_found_in_the_scanner_that_has_it(extracted, cheated, honest):
    scanners = [
        replace(each, world=World((DISC,))) if each.topic == cheated else each
        for each in (FRONT, BACK)
    ]
    values, where, _ = extracted(recording(scanners))
    assert values["scan_contradicted"] == pytest.approx(DISC_SHARE, rel=0.3)
    assert values["scan_persistence"] == 1.0
    for name in ("scan_contradicted", "scan_persistence"):
        assert where[name] == f"{cheated} against {honest}"
    assert values["scan_residual"] < 0.01


def test_a_scanner_that_is_blind_to_an_object_is_contradicted_by_the_other(extracted):
    values, where, _ = extracted(recording([FRONT, replace(BACK, world=World((DISC,)))]))
    assert values["scan_contradicted"] > 0.01
    assert where["scan_contradicted"] == "/back against /front"


def test_more_noise_is_more_residual(extracted):
    residuals = [
        extracted(recording([FRONT, replace(BACK, noise=noise)]))[0]["scan_residual"]
        for noise in (0.0, 0.02, 0.05, 0.1)
    ]
    assert residuals == sorted(residuals)
    assert residuals[-1] > 5.0 * residuals[0]


def test_motion_between_the_scans_is_taken_out(extracted):
    world = World((DISC,))
    scanners = [replace(FRONT, late_s=0.1, world=world), replace(BACK, world=world)]
    with_odometry, *_ = extracted(recording(scanners, turning))
    without, _, missing = extracted(recording(scanners, turning, odometry=False))
    assert with_odometry["scan_contradicted"] == 0.0
    assert without["scan_residual"] > 2.0 * with_odometry["scan_residual"]
    assert missing["scan_persistence"] == "no odometry"


def test_a_scanner_may_hang_upside_down(extracted):
    world = World(((1.0, 0.8, 0.2),))
    upright = replace(FRONT, world=world)
    values, *_ = extracted(recording([upright, replace(BACK, world=world, upside_down=True)]))
    assert values["scan_contradicted"] == 0.0
    assert values["scan_residual"] < 0.01


def test_one_scanner_alone_gives_a_reason(extracted):
    values, _, missing = extracted(recording([BACK]))
    assert np.isnan(values["scan_residual"])
    assert "fewer than two" in missing["scan_residual"]


def test_scanners_whose_frames_are_not_joined_give_a_reason(extracted):
    recorded = [each for each in recording([FRONT, BACK]) if each[1] != "/tf_static"]
    _, _, missing = extracted(recorded)
    assert "/tf_static" in missing["scan_residual"]


def test_scans_may_differ_in_length(extracted):
    recorded = recording([BACK, replace(BACK, topic="/copy")])
    recorded.append((3.05, "/back", scan_message(3.05, frame_of("/back"), np.full(180, 1.0))))
    values, *_ = extracted(recorded)
    assert values["scan_residual"] == pytest.approx(0.0, abs=1e-6)


def with_range(measured, world=World()):  # noqa: B008 -- frozen
    """A scanner at the base, and a range sensor 0.1 m ahead of it that faces the wall."""
    ranges = [(t / 5, "/range", range_message(t / 5, "nose", measured)) for t in range(1, 30)]
    return sorted(recording([replace(BACK, world=world)]) + ranges, key=lambda each: each[0])


def test_a_range_is_compared_with_the_scans_in_its_cone(extracted):
    near = World(room_m=1.0)
    agreed, *_ = extracted(with_range(0.9, near))
    assert agreed["range_residual"] == pytest.approx(0.0, abs=1e-3)
    assert agreed["range_contradicted"] == 0.0
    blocked, where, _ = extracted(with_range(0.4, near))
    assert blocked["range_residual"] == pytest.approx(0.5, abs=1e-3)
    assert blocked["range_contradicted"] == 1.0
    assert where["range_residual"] == "/range against /back"


@pytest.mark.parametrize("measured", [np.inf, 1.8])
def test_a_range_beyond_the_limit_is_the_limit(extracted, measured):
    assert ROOM_M - 0.1 > 1.8  # the sensor's limit
    values, *_ = extracted(with_range(measured))
    assert values["range_residual"] == pytest.approx(0.0, abs=1e-6)


def test_scans_without_a_ray_or_a_partner_give_reasons(extracted):
    def empty(time_s, topic):
        return time_s, topic, scan_message(time_s, frame_of(topic), [])

    lonely = [each for each in recording([FRONT, BACK]) if each[1] != "/back"]
    lonely += [empty(t / 5, "/back") for t in range(30)]
    values, _, missing = extracted(sorted(lonely, key=lambda each: each[0]))
    assert np.isnan(values["scan_residual"])
    assert "Error" not in missing["scan_residual"]
    late = [
        each for each in recording([FRONT, BACK]) if (each[1] == "/back") == (each[0] > 3.0)
        or each[1] == "/tf_static"
    ]  # fmt: skip
    _, _, missing = extracted(late)
    assert missing["scan_residual"] == "no two scanners measured the same area at the same time"
