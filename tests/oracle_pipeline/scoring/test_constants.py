import numpy as np
import pytest

from oracle_pipeline.scoring.constants import MOST_MESSAGES
from oracle_pipeline.scoring.pace import FEWEST
from tests.oracle_pipeline.features.conftest import message_class
from tests.oracle_pipeline.features.scenery import (
    header,
    odometry_message,
    scan_message,
    transforms,
)


def scans(count, alter=None):
    made = []
    for number in range(count):
        message = scan_message(number, "laser", np.full(8, 1.0 + number))
        if alter:
            alter(message, number)
        made.append((float(number), "/scan", message))
    return made


@pytest.fixture
def constants_of(observer_of):
    return lambda recorded: observer_of(recorded).samples.constants()


def test_fixed_parameters_of_a_sensor_are_constants_and_measurements_are_not(constants_of):
    driven = [(float(i), "/odom", odometry_message(i, 0.1j * i, 0.0)) for i in range(FEWEST)]
    found = constants_of(scans(FEWEST) + driven)
    assert found["/scan"]["header.frame_id"] == "'laser'"
    assert not {"ranges", "header.stamp.sec"} & found["/scan"].keys()
    assert found["/odom"]["pose.pose.position.x"] == "0"
    assert found["/odom"]["pose.covariance"] == f"[{', '.join(['0'] * 36)}]"
    assert "pose.pose.position.y" not in found["/odom"]


@pytest.mark.parametrize(
    ("said", "texts"),
    [
        (["idle", "goal 1", "goal 2", "idle"], {"data": "like 'goal #' or 'idle'"}),
        (["idle"], {"data": "'idle'"}),
        ([chr(ord("a") + n) for n in range(9)], {}),
    ],
)
def test_a_text_that_changes_between_few_is_known_by_them(constants_of, said, texts):
    make = message_class("std_msgs/msg/String")
    recorded = [(1.0 * n, "/state", make(said[n % len(said)])) for n in range(36)]
    assert constants_of(recorded) == {"/state": texts}


@pytest.mark.parametrize("count", [2, 20 * MOST_MESSAGES])
def test_each_text_of_a_state_is_known_however_seldom_it_is_said(constants_of, count):
    make = message_class("std_msgs/msg/String")
    recorded = [(0.1 * n, "/state", make("FAIL" if n == 1 else "idle")) for n in range(count)]
    assert constants_of(recorded) == {"/state": {"data": "like 'FAIL' or 'idle'"}}


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


def safety_zones(count, alter=None):
    polygon = message_class("geometry_msgs/msg/PolygonStamped")
    shape, point = (message_class(f"geometry_msgs/msg/{name}") for name in ("Polygon", "Point32"))
    for number in range(count):
        corners = [(0.3, 0.2), (0.3, -0.2), (-0.3, 0.0)]
        if alter:
            corners = alter(corners, number)
        zone = shape(points=[point(x=x, y=y, z=0.0) for x, y in corners])
        yield float(number), "/stop_zone", polygon(header=header(number, "base"), polygon=zone)


def test_a_sequence_of_fixed_length_is_constant_if_all_its_elements_are(constants_of):
    found = constants_of(list(safety_zones(FEWEST)))["/stop_zone"]
    assert found["polygon.points.y"] == "[0.200000003, -0.200000003, 0]"


@pytest.mark.parametrize(
    "alter",
    [
        lambda corners, number: [*corners[:2], (-0.3, 0.01 * number)],
        lambda corners, number: corners[: 3 - number % 2],
    ],
)
def test_a_sequence_whose_elements_or_length_change_is_not_constant(constants_of, alter):
    found = constants_of(list(safety_zones(FEWEST, alter)))["/stop_zone"]
    assert "polygon.points.y" not in found


def test_names_of_joints_are_constant(constants_of):
    joints = message_class("sensor_msgs/msg/JointState")
    recorded = [
        (float(i), "/joints", joints(
            header=header(i, ""), name=["left", "right"], position=np.array([0.1 * i, 1.0]),
            velocity=np.zeros(0), effort=np.zeros(2),
        ))
        for i in range(FEWEST)
    ]  # fmt: skip
    found = constants_of(recorded)["/joints"]
    assert found["name"] == "['left', 'right']"
    assert found["effort"] == "[0, 0]"
    assert not {"position", "velocity"} & found.keys()


def test_the_mount_of_a_sensor_is_constant_though_it_is_published_once(constants_of):
    mount = transforms(("base", "laser", 0.1, False))
    found = constants_of([(0.0, "/tf_static", mount), *scans(FEWEST)])["/tf_static"]
    assert found["base -> laser translation"] == "[0.1, 0, 0]"
    assert found["base -> laser rotation"] == "[0, 0, 0, 1]"


def test_a_transform_that_is_published_with_two_values_is_not_constant(constants_of):
    mounts = [(float(i), "/tf_static", transforms(("base", "nose", i, False))) for i in range(2)]
    assert constants_of(mounts)["/tf_static"].keys() == {"base -> nose rotation"}


def test_the_link_of_a_joint_that_turns_is_mounted_in_one_place(constants_of):
    turning = [
        (float(i), "/tf", transforms(("base", "link", 0.3, False), ("odom", "base", i, False)))
        for i in range(FEWEST)
    ]
    found = constants_of(turning)["/tf"]
    assert found["base -> link translation"] == "[0.3, 0, 0]"
    assert "odom -> base translation" not in found


VALUES = {
    "bool_value": False, "integer_value": 0, "double_value": 0.0, "string_value": "",
    "byte_array_value": np.zeros(0, np.uint8), "bool_array_value": np.zeros(0, np.bool_),
    "integer_array_value": np.zeros(0, np.int64), "double_array_value": np.zeros(0),
    "string_array_value": [],
}  # fmt: skip


def parameter_events(*values, node="/planner", declared=False):
    event, parameter, value = (
        message_class(f"rcl_interfaces/msg/{name}")
        for name in ("ParameterEvent", "Parameter", "ParameterValue")
    )
    for number, (name, field, given) in enumerate(values):
        kind = 1 + list(VALUES).index(field)
        reported = [parameter(name, value(kind, **{**VALUES, field: given}))]
        of = (reported, [], []) if declared else ([], reported, [])
        yield float(number), "/parameter_events", event(header(number, "").stamp, node, *of)


def test_the_last_value_of_each_parameter_is_known(observer_of):
    told = parameter_events(
        ("tolerance", "double_value", 0.5), ("tolerance", "double_value", 0.25),
        ("enabled", "bool_value", True), ("frame", "string_value", "map" * 40),
        ("corners", "double_array_value", np.array([1.0, 2.0])), ("limit", "double_value", np.inf),
    )  # fmt: skip
    found, changed = observer_of(list(told)).samples.parameters()
    assert changed == found.keys()
    assert found.pop("/planner frame").startswith("map" * 20 + "... (")
    assert found == {
        "/planner tolerance": 0.25, "/planner enabled": 1.0, "/planner corners": "1.0, 2.0",
        "/planner limit": "inf",
    }  # fmt: skip


def test_what_a_node_declares_is_not_set(observer_of):
    speed = ("speed", "double_value", 0.26)
    assert observer_of(list(parameter_events(speed, declared=True))).samples.parameters() == (
        {"/planner speed": 0.26}, frozenset(),
    )  # fmt: skip


def test_the_number_of_a_process_and_tools_of_ros_make_no_other_parameter(observer_of):
    speed = ("speed", "double_value", 0.26)
    names = (
        "/listener_impl_7f3a21",
        "/listener_impl_8b0012",
        "/_ros2cli_4711",
        "/rosbag2_recorder",
    )
    told = [each for name in names for each in parameter_events(speed, node=name)]
    assert observer_of(told).samples.parameters() == (
        {"/listener_impl_* speed": 0.26}, {"/listener_impl_* speed"},
    )  # fmt: skip
