"""The roles file, and the commands that take it."""

import json

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.cli import main
from oracle_pipeline.robots.roles import ROLES, RolesError
from oracle_pipeline.robots.roles_file import RoleChoices
from tests.oracle_pipeline.features.conftest import drive, write_bag
from tests.oracle_pipeline.robots.recordings import ODOMETRY, SCAN, bag_with

GOOD = """\
robots: [/robot1, /]
roles:
  odometry: /wheel/odometry
  scan: [/front/scan, /rear/scan]
  pose: []
"""


def written(folder, text):
    (folder / "roles.yaml").write_text(text)
    return folder / "roles.yaml"


def oracle(*arguments):
    return CliRunner().invoke(main, list(map(str, arguments)))


def test_a_roles_file_has_robots_and_topics(tmp_path):
    choices = RoleChoices.load(written(tmp_path, GOOD))
    assert choices.robots == ("/robot1", "")
    assert choices.topics == {
        "odometry": ("/wheel/odometry",), "scan": ("/front/scan", "/rear/scan"), "pose": (),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[1, 2]", "the file must be a mapping of robots, roles"),
        ("topics: {}", "the file has topics; known are robots, roles"),
        ("roles: {scanner: /scan}", "roles has scanner; known are scan, odometry"),
        ("roles: {scan: scan}", "begin with a slash, found 'scan'"),
        ("roles: {scan: [[/scan]]}", "begin with a slash"),
        ("roles: {odometry: [/a, /b]}", "a robot has one odometry, found /a, /b"),
        ("robots: robot1", "begin with a slash, found 'robot1'"),
        ("roles: &a {scan: *a}", "alias"),
        ("roles: !!python/name:os.system {}", "tag"),
        ("[" * 100, "deeper than"),
        ("a: b: c", "mapping values"),
        ("x" * 70_000, "larger than 65536 bytes"),
    ],
)
def test_an_invalid_roles_file_is_an_error_with_the_fault(text, reason, tmp_path):
    with pytest.raises(RolesError, match=reason):
        RoleChoices.load(written(tmp_path, text))


@given(
    st.builds(
        RoleChoices,
        st.none() | st.lists(st.sampled_from(["", "/a", "/a/b"]), unique=True).map(tuple),
        st.fixed_dictionaries(
            {}, optional={role: st.sampled_from([(), ("/topic",)]) for role in ROLES}
        ),
    )
)
def test_choices_survive_a_round_trip(choices):
    assert RoleChoices.of(json.loads(json.dumps(choices.document()))) == choices


def test_the_command_prints_roles_as_text(tmp_path):
    recorded = {"/left/odom": ODOMETRY, "/right/odom": ODOMETRY, "/front": SCAN}
    bag = bag_with(tmp_path / "bag", recorded)
    done = oracle("features", bag, "--roles")
    assert done.exit_code == 0, done.output
    assert "scan               /front (by message type)" in done.output
    assert "Note: /left/odom is used as odometry" in done.output
    assert "imu                none (no topic of type sensor_msgs/msg/Imu)" in done.output


def test_the_command_gives_a_row_for_each_robot(tmp_path):
    both = [(t, f"/{name}{n}", m) for t, n, m in drive() for name in ("a", "b") if "_" not in n]
    write_bag(tmp_path / "bag", both)
    done = oracle("features", tmp_path / "bag")
    document = json.loads(done.stdout)
    assert [row["run_id"] for row in document["rows"]] == ["bag#a", "bag#b"]
    one = oracle("features", tmp_path / "bag", "--roles", written(tmp_path, "robots: [/b]"))
    assert [row["run_id"] for row in json.loads(one.stdout)["rows"]] == ["bag"]


def test_a_roles_file_changes_the_topics_of_features(tmp_path):
    write_bag(tmp_path / "bag", [each for each in drive() if each[1] == "/odom"])
    roles = written(tmp_path, "roles: {odometry: []}")
    (row,) = json.loads(oracle("features", tmp_path / "bag", "--roles", roles).stdout)["rows"]
    assert row["contextual.total_turning"] is None
    assert row["missing"]["contextual.total_turning"] == (
        "no topic for the role odometry is recorded"
    )


def test_a_missing_roles_file_ends_with_2(tmp_path):
    bag = bag_with(tmp_path / "bag", {})
    assert oracle("features", bag, "--roles", tmp_path / "none.yaml").exit_code == 2
    assert oracle("score", bag, "--reference", bag, "--roles", tmp_path / "none").exit_code == 2
