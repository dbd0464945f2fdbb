"""Roles of topics, by message type, then usual name, then frame."""

import pytest

from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.robots.roles import ROLES, RolesError, find_roles
from tests.oracle_pipeline.features.conftest import write_bag
from tests.oracle_pipeline.robots.recordings import (
    CLOUD,
    GRID,
    IMU,
    JOINTS,
    ODOMETRY,
    PATH,
    POSE,
    SCAN,
    STAMPED,
    TF,
    TWIST,
    bag_with,
    grid,
    odometry,
    pose,
    scan,
    static,
)


def roles_of(path, chosen=None):
    with BagReader(path) as bag:
        return find_roles(bag, chosen)


def topics(roles):
    return {role: found.topics for role, found in roles.found.items() if found.topics}


@pytest.mark.parametrize(
    ("recorded", "role", "expected"),
    [
        ({"/laser": SCAN, "/points": CLOUD}, "scan", ("/laser",)),
        ({"/points": CLOUD, "/depth": CLOUD}, "scan", ("/depth", "/points")),
        ({"/b/scan": SCAN, "/a/scan": SCAN}, "scan", ("/a/scan", "/b/scan")),
        ({"/wheels": ODOMETRY}, "odometry", ("/wheels",)),
        ({"/base/odom": ODOMETRY, "/a_filter": ODOMETRY}, "odometry", ("/base/odom",)),
        ({"/imu/data": IMU}, "imu", ("/imu/data",)),
        ({"/dynamic_joint_states": JOINTS}, "joints", ("/dynamic_joint_states",)),
        ({"/drive": STAMPED}, "command", ("/drive",)),
        ({"/drive": TWIST, "/measured": STAMPED}, "command", ("/drive",)),
        ({"/cmd_vel": TWIST, "/cmd_vel_raw": TWIST}, "command", ("/cmd_vel",)),
        ({"/cmd_vel": TWIST, "/cmd_vel_raw": TWIST}, "requested_command", ("/cmd_vel_raw",)),
        ({"/cmd_vel_raw": TWIST}, "command", ()),
        ({"/mavros/local_position/velocity": STAMPED, "/gps_vel": STAMPED}, "command", ()),
        ({"/initialpose": POSE}, "pose", ()),
        ({"/initialpose": POSE, "/pose": POSE}, "pose", ("/pose",)),
        ({"/global_costmap/costmap": GRID}, "map", ()),
        ({"/the_map": GRID, "/local_costmap/costmap": GRID}, "map", ("/the_map",)),
        ({"/local_costmap/costmap": GRID}, "local_costmap", ("/local_costmap/costmap",)),
        ({"/local_plan": PATH, "/route": PATH}, "plan", ("/route",)),
        ({"/tf": TF, "/tf_static": TF}, "transforms", ("/tf",)),
        ({"/tf": TF, "/tf_static": TF}, "static_transforms", ("/tf_static",)),
        ({"/moved": TF}, "transforms", ("/moved",)),
    ],
)
def test_roles_are_found_by_type_and_usual_name(recorded, role, expected, tmp_path):
    roles = roles_of(bag_with(tmp_path / "bag", recorded))
    assert roles.found[role].topics == expected
    assert roles.ambiguities() == []


def test_odometry_is_that_of_the_body_that_carries_the_sensors(tmp_path):
    recorded = [
        (0.0, "/a_camera/track", odometry("camera_pose")),
        (0.0, "/z_wheels/track", odometry("base_link")),
        (0.0, "/laser", scan("laser_link")),
        (0.0, "/tf_static", static(("base_link", "laser_link"), ("base_link", "camera_link"))),
    ]
    write_bag(tmp_path / "bag", recorded)
    roles = roles_of(tmp_path / "bag")
    assert roles.found["odometry"].topics == ("/z_wheels/track",)
    assert roles.found["odometry"].reason == "by message type and frame"
    assert roles.ambiguities() == []


def test_grids_are_distinguished_by_their_frames(tmp_path):
    recorded = [
        (0.0, "/a_grid", grid("odom")), (0.0, "/b_grid", grid("map")), (0.0, "/where", pose("map")),
        (0.0, "/wheels", odometry("base_link")),
    ]  # fmt: skip
    write_bag(tmp_path / "bag", recorded)
    found = topics(roles_of(tmp_path / "bag"))
    assert found["map"] == ("/b_grid",)
    assert found["local_costmap"] == ("/a_grid",)


def test_ambiguous_roles_are_reported(tmp_path):
    bag = bag_with(tmp_path / "bag", {"/left": ODOMETRY, "/right": ODOMETRY})
    roles = roles_of(bag)
    assert roles.found["odometry"].topics == ("/left",)
    (note,) = roles.ambiguities()
    assert "/left is used as odometry" in note
    assert "/right would fit too" in note
    assert roles_of(bag, {"odometry": ("/right",)}).ambiguities() == []


def test_a_topic_with_messages_has_precedence_over_a_silent_one(tmp_path):
    write_bag(tmp_path / "recorded", [(0.0, "/b_track", odometry("base"))])
    silent = bag_with(tmp_path / "silent", {"/a_track": ODOMETRY})
    assert topics(roles_of(silent))["odometry"] == ("/a_track",)
    assert topics(roles_of(tmp_path / "recorded"))["odometry"] == ("/b_track",)


def test_a_roles_file_has_precedence_and_missing_topics_are_reported(tmp_path):
    bag = bag_with(tmp_path / "bag", {"/odom": ODOMETRY, "/wheels": ODOMETRY, "/laser": SCAN})
    roles = roles_of(bag, {"odometry": ("/wheels",), "scan": ("/laser", "/gone"), "imu": ()})
    assert topics(roles) == {"odometry": ("/wheels",), "scan": ("/laser",)}
    assert roles.notes == ("The roles file names /gone as scan, but it is not recorded.",)


def test_a_topic_with_the_wrong_type_is_an_error(tmp_path):
    bag = bag_with(tmp_path / "bag", {"/laser": SCAN})
    with pytest.raises(RolesError, match="/laser as odometry, but its type is sensor_msgs"):
        roles_of(bag, {"odometry": ("/laser",)})


def test_no_role_is_found_in_a_bag_without_a_robot(tmp_path):
    roles = roles_of(bag_with(tmp_path / "bag", {}))
    assert topics(roles) == {}
    assert roles.found.keys() == ROLES.keys()
