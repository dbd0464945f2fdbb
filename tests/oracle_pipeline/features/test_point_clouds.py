"""A point cloud as a planar scanner: the same scene as points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.types import message_class
from oracle_pipeline.features.engine.point_clouds import FARTHEST_M, RAYS, sliced
from oracle_pipeline.features.lidar import laser_ranges, redundancy, scan
from oracle_pipeline.features.motion import kinematics, velocity
from oracle_pipeline.features.traffic import delays
from tests.oracle_pipeline.features.scenery import (
    Scanner,
    World,
    driving,
    extract,
    header,
    recording,
)
from tests.oracle_pipeline.robots.recordings import stamped_twist

PLUGINS = [
    plugin
    for module in (laser_ranges, redundancy, scan, delays, kinematics)
    for plugin in module.register_features()
]


def cloud(points, *, seconds=0.0, frame="laser", big=False, double=False, padding=4, width=None):
    """A ``PointCloud2`` of points, shape (n, 3), of which each has some bytes more."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    kind, order = ("f8", 8) if double else ("f4", 4), ">" if big else "<"
    name, size = kind
    layout = np.dtype(
        {"names": list("xyz"), "formats": [order + name] * 3, "offsets": [0, size, 2 * size],
         "itemsize": 3 * size + padding}
    )  # fmt: skip
    data = np.zeros(len(points), dtype=layout)
    for column, axis in enumerate("xyz"):
        data[axis] = points[:, column]
    field = message_class("sensor_msgs/msg/PointField")
    fields = [field(axis, i * size, 8 if double else 7, 1) for i, axis in enumerate("xyz")]
    rows = 1 if width is None else len(points) // width
    row_step = layout.itemsize * len(points) // max(rows, 1)
    return message_class("sensor_msgs/msg/PointCloud2")(
        header(seconds, frame), rows, len(points) // max(rows, 1), fields, big, layout.itemsize,
        row_step, np.frombuffer(data.tobytes(), dtype=np.uint8), True,
    )  # fmt: skip


def of_scan(message):
    """The points of a scan's returns, and others above and below of the plane."""
    bearings = message.angle_min + message.angle_increment * np.arange(len(message.ranges))
    near = np.isfinite(message.ranges)
    x, y = (f(bearings[near]) * message.ranges[near] for f in (np.cos, np.sin))
    flat = np.column_stack([x, y, np.zeros(len(x))])
    return np.concatenate([flat, flat * 0.5 + (0, 0, 0.4), flat * 0.5 - (0, 0, 0.4)])


def as_clouds(recorded):
    return [
        (t, n, cloud(of_scan(m), seconds=t, frame=m.header.frame_id) if "scan" in n else m)
        for t, n, m in recorded
    ]


def test_a_cloud_has_the_features_of_the_scan_in_its_plane(tmp_path):
    world = World(((1.0, 0.7, 0.2), (-1.2, 0.4, 0.3)))
    scanners = [Scanner("/scan_a", 0.05, world), Scanner("/scan_b", -0.05, world)]
    recorded = recording(scanners, driving)
    from_scans, *_ = extract(PLUGINS, recorded, tmp_path / "scans")
    read, _, missing = extract(PLUGINS, as_clouds(recorded), tmp_path / "clouds")
    assert "scan_latency" not in missing
    for name in (
        "range_variance_mean", "non_finite_max", "scan_residual", "scan_contradicted",
        "innovation", "scan_latency", "travel_residual_pose_scan", "turn_scale_pose_scan",
    ):  # fmt: skip
        assert read[name] == pytest.approx(from_scans[name], rel=0.02, abs=2e-3, nan_ok=True), name


@given(
    st.lists(st.tuples(*[st.floats(-60, 60, width=32)] * 3), max_size=60),
    st.booleans(), st.booleans(),
)  # fmt: skip
def test_ranges_are_those_of_the_nearest_point_in_each_direction(points, big, double):
    ranges = sliced(cloud(points, big=big, double=double)).ranges
    expected = {}
    for x, y, z in points:
        distance = np.hypot(x, y)
        tolerance = max(0.05, np.tan(np.radians(1.5)) * distance)
        if abs(z) <= tolerance and 0.05 <= distance <= FARTHEST_M:
            ray = round((np.arctan2(y, x) + np.pi) * RAYS / (2 * np.pi)) % RAYS
            expected[ray] = min(distance, expected.get(ray, np.inf))
    assert len(ranges) == RAYS
    assert dict(enumerate(ranges[np.isfinite(ranges)])).keys() == set(range(len(expected)))
    for ray, distance in expected.items():
        assert ranges[ray] == pytest.approx(distance, rel=1e-6)


def test_rows_may_be_padded_and_unknown_points_are_no_returns():
    points = np.array([[1.0, 0, 0], [np.nan] * 3, [0, 2.0, 0], [np.inf] * 3])
    ranges = sliced(cloud(points, width=2)).ranges
    assert sorted(ranges[~np.isnan(ranges)].tolist()) == [1.0, 2.0]
    assert np.isnan(sliced(cloud([])).ranges).all()


def broken(**changes):
    message = cloud([[1.0, 0.0, 0.0]] * 4)
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"fields": []}, "without x, y and z"),
        ({"width": 5}, "1 rows of 80 bytes in 64 bytes"),
        ({"height": 2**31, "width": 2**31}, "bytes in 64 bytes"),
        ({"point_step": 4}, "not laid out"),
        ({"point_step": 0}, "not laid out"),
    ],
)
def test_a_broken_cloud_is_refused(changes, reason):
    with pytest.raises(BagError, match=reason):
        sliced(broken(**changes))


def test_coordinates_have_to_be_lengths():
    message = broken()
    message.fields[0].datatype = 5
    with pytest.raises(BagError, match="not floating-point numbers"):
        sliced(message)


def test_stamped_commands_count_as_commands(tmp_path):
    plugins = velocity.register_features()
    sent = [(t / 10, "/drive", stamped_twist(t / 10, 0.0, (-1.0) ** t)) for t in range(10)]
    values, *_ = extract(plugins, sent, tmp_path)
    assert values["command_reversals"] == pytest.approx(9 * 60.0)
