import math

import numpy as np
import pytest

from oracle_pipeline.bags.manifest import GoalResult, Manifest, Measured, Pose, Software
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.types import message_class, serialize
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.reporting.result import ReportError
from oracle_pipeline.reporting.run_picture import run_picture, run_scene
from oracle_pipeline.runs import Run

QUARTER = math.pi / 2
FAKE_OBJECT = {"frame": "odom", "x": 1.0, "y": 0.0, "radius": 0.2}


def make(name, **fields):
    return message_class(name)(**fields)


def header(frame):
    return make(
        "std_msgs/msg/Header",
        stamp=make("builtin_interfaces/msg/Time", sec=0, nanosec=0),
        frame_id=frame,
    )


def pose(x, y, yaw):
    return make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
        orientation=make(
            "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2)
        ),
    )


def tf(parent, child, x, y, yaw):
    at = pose(x, y, yaw)
    transform = make(
        "geometry_msgs/msg/Transform",
        translation=make("geometry_msgs/msg/Vector3", x=x, y=y, z=0.0),
        rotation=at.orientation,
    )
    stamped = make(
        "geometry_msgs/msg/TransformStamped",
        header=header(parent),
        child_frame_id=child,
        transform=transform,
    )
    return make("tf2_msgs/msg/TFMessage", transforms=[stamped])


def odometry(x, y, yaw):
    zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    return make(
        "nav_msgs/msg/Odometry",
        header=header("odom"),
        child_frame_id="base_footprint",
        pose=make(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose(x, y, yaw), covariance=np.zeros(36)
        ),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def occupancy():
    info = make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=make("builtin_interfaces/msg/Time", sec=0, nanosec=0),
        resolution=0.5,
        width=3,
        height=2,
        origin=pose(-1.0, -2.0, 0.0),
    )
    data = np.array([-1, 0, 100, 0, 0, 0], dtype=np.int8)
    return make("nav_msgs/msg/OccupancyGrid", header=header("map"), info=info, data=data)


def scan(*ranges):
    return make(
        "sensor_msgs/msg/LaserScan",
        header=header("base_scan_tom"),
        angle_min=0.0,
        angle_max=0.0,
        angle_increment=QUARTER,
        time_increment=0.0,
        scan_time=0.2,
        range_min=0.1,
        range_max=3.5,
        ranges=np.array(ranges, dtype=np.float32),
        intensities=np.array([], dtype=np.float32),
    )


MAP_TO_ODOM = ("/tf", "tf2_msgs/msg/TFMessage", tf("map", "odom", 10.0, 0.0, QUARTER))
MOUNT = (
    "/tf_static",
    "tf2_msgs/msg/TFMessage",
    tf("base_footprint", "base_scan_tom", 0.5, 0.0, 0.0),
)
MAP = ("/map", "nav_msgs/msg/OccupancyGrid", occupancy())


def at(x, y, yaw=0.0):
    return ("/odom", "nav_msgs/msg/Odometry", odometry(x, y, yaw))


def seen(*ranges):
    return ("/scan_fakeobject", "sensor_msgs/msg/LaserScan", scan(*ranges))


def manifest(label, attack):
    return Manifest(
        mode="fake_object",
        label=label,
        run=3,
        block=3,
        session=0,
        seed=0,
        start=Pose(10.0, 0.0, QUARTER),
        goals=(Pose(10.0, 2.0, 0.0),),
        goal_results=(GoalResult(0.0, 1.0, "succeeded"),),
        outcome="succeeded",
        onset_s=None,
        attack=attack,
        scenario="",
        scenario_hash="",
        task_effect=None,
        recording_s=1.0,
        contacts=(),
        topics={},
        content_hash="",
        recipe={},
        software=Software("", "", ""),
        measured=Measured(0.0, {}),
    )


@pytest.fixture
def recorded(tmp_path):
    """Return a function that records messages, a tenth of a second apart, and opens the run."""

    def record(*messages, label="malicious", attack=FAKE_OBJECT):
        with BagWriter(tmp_path / "bag") as bag:
            for topic, msgtype in {topic: msgtype for topic, msgtype, _ in messages}.items():
                bag.add_topic(topic, msgtype, [])
            for number, (topic, msgtype, message) in enumerate(messages):
                bag.write(topic, number * 100_000_000, serialize(message, msgtype))
        return Run(tmp_path, BagReader(tmp_path / "bag"), manifest(label, attack), ())

    return record


def test_the_way_driven_is_odometry_in_the_map_frame(recorded):
    with recorded(MAP, at(9.0, 9.0), MAP_TO_ODOM, at(0.0, 0.0), at(2.0, 0.0)) as run:
        scene = run_scene(run)
    assert scene.path == pytest.approx(np.array([[10.0, 0.0], [10.0, 2.0]]))
    assert scene.occupancy.tolist() == [[-1, 0, 100], [0, 0, 0]]
    assert (scene.resolution_m, scene.origin) == (0.5, (-1.0, -2.0))
    assert (scene.start, scene.goals.tolist()) == ((10.0, 0.0), [[10.0, 2.0, 0.0]])


def test_the_fake_object_and_the_scan_from_nearest_to_it_are_on_the_map(recorded):
    far, near = (at(-3.0, 0.0), seen(1.0, 1.0)), (at(0.0, 0.0), seen(0.3, math.inf, 2.0))
    with recorded(MAP, MAP_TO_ODOM, MOUNT, *far, *near, *far) as run:
        scene = run_scene(run)
        assert run_picture(run).startswith(b"\x89PNG")
    assert scene.disc == pytest.approx((10.0, 1.0, 0.2))
    assert scene.scan == pytest.approx(np.array([[10.0, 0.8], [10.0, -1.5]]), abs=1e-6)


def test_without_an_object_the_scan_is_that_from_halfway(recorded):
    drive = [part for x in range(5) for part in (at(float(x), 0.0), seen(1.0))]
    with recorded(MAP, MAP_TO_ODOM, MOUNT, *drive, attack={"level": 0.1}) as run:
        scene = run_scene(run)
    assert scene.disc is None
    assert scene.scan == pytest.approx(np.array([[10.0, 2.5]]), abs=1e-6)  # driven 1, mounted 0.5


def test_of_a_right_run_nothing_attacked_is_shown(recorded):
    with recorded(
        MAP, MAP_TO_ODOM, MOUNT, at(0.0, 0.0), seen(1.0), label="normal", attack={}
    ) as run:
        scene = run_scene(run)
    assert scene.disc is scene.scan is None


@pytest.mark.parametrize(
    ("messages", "lacking"),
    [
        ([MAP_TO_ODOM, at(0.0, 0.0)], "has no /map"),
        ([MAP, at(0.0, 0.0)], "a transform from map to odom"),
        ([MAP, MAP_TO_ODOM], "has no /odom"),
    ],
)
def test_a_bag_that_lacks_a_part_is_refused_by_its_name(recorded, messages, lacking):
    with recorded(*messages) as run, pytest.raises(ReportError, match=lacking):
        run_scene(run)


def test_frames_that_hang_in_a_ring_are_nowhere(recorded):
    ring = ("/tf", "tf2_msgs/msg/TFMessage", tf("base_footprint", "odom", 0.0, 0.0, 0.0))
    with recorded(MAP, ring, at(0.0, 0.0)) as run, pytest.raises(ReportError, match="transform"):
        run_scene(run)


def test_a_foreign_bag_is_refused(recorded):
    with recorded(MAP) as run, pytest.raises(ReportError, match="recorded by somebody else"):
        run_picture(Run(run.path, run.bag, None, ()))
