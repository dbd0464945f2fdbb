"""Which namespaces of a recording are robots, and features that do not depend on namespaces."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from oracle_pipeline import features
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.datasets import content_hash, feature_columns
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.robots.robot import find_robots
from oracle_pipeline.robots.roles_file import RoleChoices, RolesError
from tests.oracle_pipeline.features.conftest import drive, write_bag
from tests.oracle_pipeline.robots.recordings import (
    CLOUD,
    GRID,
    IMU,
    JOINTS,
    ODOMETRY,
    SCAN,
    TF,
    TWIST,
    bag_with,
)

MANAGER = features.build_manager()
SMALL = {"/odom": ODOMETRY, "/scan": SCAN, "/cmd_vel": TWIST}


def below(space, recorded):
    return {f"{space}{name}": each for name, each in recorded.items()}


def robots_of(path, choices=None):
    """Return the topics that each robot sees, by its name."""
    with BagReader(path) as bag:
        return {robot.name: set(robot.bag.topics) for robot in find_robots(bag, choices)}


@pytest.mark.parametrize(
    ("recorded", "names"),
    [
        (SMALL, [""]),
        (below("/robot1", SMALL), [""]),
        (below("/robot1", SMALL) | below("/robot2", SMALL), ["robot1", "robot2"]),
        (below("/a/r1", SMALL) | below("/a/r2", SMALL) | {"/map": GRID}, ["a/r1", "a/r2"]),
        (
            below("/r1/base", {"/odom": ODOMETRY, "/cmd_vel": TWIST}) | {"/r1/lidar/scan": SCAN}
            | below("/r2", SMALL), ["r1", "r2"],
        ),
        (below("/r1", SMALL) | below("/r2", SMALL) | {"/cmd_vel": TWIST}, ["r1", "r2"]),
        # One robot whose parts have namespaces.
        ({"/front/scan": SCAN, "/rear/scan": SCAN, "/wheels/odom": ODOMETRY}, [""]),
        (SMALL | below("/camera", {"/odom": ODOMETRY, "/imu": IMU, "/scan": SCAN}), [""]),
        ({"/base/odom": ODOMETRY, "/base/cmd_vel": TWIST, "/joint_states": JOINTS}, [""]),
        ({"/camera/points": CLOUD, "/camera/imu": IMU}, [""]),
        ({}, [""]),
    ],
)  # fmt: skip
def test_robots_are_found_by_namespace(recorded, names, tmp_path):
    assert sorted(robots_of(bag_with(tmp_path / "bag", recorded))) == names


def test_robots_have_their_own_topics_without_the_namespace_and_shared_ones(tmp_path):
    recorded = below("/r1", SMALL) | below("/r2", SMALL) | {"/map": GRID, "/tf": TF, "/r2/tf": TF}
    robots = robots_of(bag_with(tmp_path / "bag", recorded))
    shared = {"/map", "/tf", "/rosout_of_tests"}
    assert robots == {"r1": {*SMALL, *shared}, "r2": {*SMALL, *shared}}


def test_no_topic_of_a_single_robot_is_lost(tmp_path):
    recorded = below("/robot1", SMALL) | {"/robot1/tf": TF, "/tf": TF, "/robot1/map": GRID}
    (seen,) = robots_of(bag_with(tmp_path / "bag", recorded)).values()
    assert len(seen) == len(recorded) + 1


def test_a_missing_leading_slash_makes_no_difference(tmp_path):
    recorded = below("/robot1", SMALL) | below("/robot2", SMALL)
    bare = bag_with(tmp_path / "bare", {name.lstrip("/"): t for name, t in recorded.items()})
    assert robots_of(bare) == robots_of(bag_with(tmp_path / "bag", recorded))


def test_a_roles_file_names_the_robots(tmp_path):
    bag = bag_with(tmp_path / "bag", below("/r1", SMALL) | below("/r2", SMALL))
    assert list(robots_of(bag, RoleChoices(robots=("",)))) == [""]
    assert list(robots_of(bag, RoleChoices(robots=("/r2",)))) == [""]
    with pytest.raises(RolesError, match="names the robot /r3, but"):
        robots_of(bag, RoleChoices(robots=("/r3",)))


def extracted(path):
    with open_run(path) as run:
        return [features.extract(run, MANAGER, robot) for robot in find_robots(run.bag)]


def hashes(tables):
    return [content_hash(table.drop(columns="run_id")) for table in tables]


def renamed(recorded, space):
    return [(time_s, f"{space}{topic}", message) for time_s, topic, message in recorded]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    path = tmp_path_factory.mktemp("plain") / "robot"
    write_bag(path, drive())
    (tables,) = extracted(path)
    return tables


names = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)


@pytest.mark.slow
@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(names, min_size=1, max_size=3))
def test_features_do_not_depend_on_the_namespace(plain, tmp_path_factory, spaces):
    path = tmp_path_factory.mktemp("named") / "robot"
    truthless = [each for each in drive() if not each[1].startswith("/_")]
    write_bag(path, renamed(truthless, "/" + "/".join(spaces)))
    (tables,) = extracted(path)
    assert hashes(tables) == hashes(plain)
    assert tables.run["run_id"].tolist() == plain.run["run_id"].tolist()


def test_each_of_two_robots_has_the_features_that_it_has_alone(plain, tmp_path):
    ours = [each for each in drive() if not each[1].startswith("/_")]
    # The other one stands: its scans and odometry never change.
    theirs = [(t, topic, next(m for _, n, m in ours if n == topic)) for t, topic, _ in ours]
    both = [*renamed(ours, "/one"), *renamed(theirs, "/two")]
    write_bag(tmp_path / "robot", sorted(both, key=lambda each: each[0]))
    one, two = extracted(tmp_path / "robot")
    assert hashes(one) == hashes(plain)
    assert hashes(two) != hashes(plain)
    assert one.run["run_id"].tolist() == ["robot#one"]
    assert two.windows["run_id"].unique().tolist() == ["robot#two"]
    with open_run(tmp_path / "robot") as run:
        measured = [features.measure(run, MANAGER, robot) for robot in find_robots(run.bag)]
    joined = features.together(measured).frames()
    assert joined.run["run_id"].tolist() == ["robot#one", "robot#two"]
    assert len(joined.windows) == len(one.windows) + len(two.windows)


def test_features_of_several_robots_are_not_mixed(tmp_path):
    recorded = [each for each in drive() if each[1] in ("/odom", "/scan")]
    both = [*renamed(recorded, "/one"), *renamed(recorded, "/two")]
    write_bag(tmp_path / "robot", sorted(both, key=lambda each: each[0]))
    with (
        open_run(tmp_path / "robot") as run,
        pytest.raises(BagError, match="several robots: one, two"),
    ):
        features.extract(run, MANAGER)


REMAPPED = {
    "/odom": "/base/odometry", "/scan": "/front_lidar", "/scan_fakeobject": "/rear_lidar",
    "/behavior_tree_log": "/bt", "/plan": "/route",
}  # fmt: skip


def test_remapped_names_give_the_same_features(plain, tmp_path):
    remapped = [(t, REMAPPED[n], m) for t, n, m in drive() if n in REMAPPED]
    write_bag(tmp_path / "robot", remapped)
    (tables,) = extracted(tmp_path / "robot")
    for ours, theirs in zip(tables, plain, strict=True):
        columns = feature_columns(theirs)
        assert content_hash(ours[columns]) == content_hash(theirs[columns])


@pytest.mark.slow
def test_roles_of_the_testbed_are_its_own_topics(recorded_run):
    named = {
        "odometry": ("/odom",), "command": ("/cmd_vel",), "requested_command": ("/cmd_vel_raw",),
        "pose": ("/amcl_pose",), "map": ("/map",), "local_costmap": ("/local_costmap/costmap",),
        "plan": ("/plan",), "behavior_tree": ("/behavior_tree_log",), "transforms": ("/tf",),
        "static_transforms": ("/tf_static",), "imu": ("/imu",), "joints": ("/joint_states",),
        "scan": ("/scan", "/scan_fakeobject", "/scan_tom"),
    }  # fmt: skip
    with open_run(recorded_run("fake_object").path) as run:
        (found,) = find_robots(run.bag)
        (robot,) = find_robots(run.bag, RoleChoices(topics=named))
        assert {role: each.topics for role, each in found.roles.found.items() if each.topics} == {
            role: each.topics for role, each in robot.roles.found.items() if each.topics
        }
        assert hashes(features.extract(run, MANAGER, found)) == hashes(
            features.extract(run, MANAGER, robot)
        )
