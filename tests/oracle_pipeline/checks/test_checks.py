"""Each fault of a sensor, a clock or the transport is found where it is; a sound drive has none."""

import json
from collections.abc import Callable
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.bags.types import message_class
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.checks.run import CHECKS, check_recording
from oracle_pipeline.checks.topic import CheckedTopic
from oracle_pipeline.cli import main
from oracle_pipeline.features.signals.collector import Signals
from tests.oracle_pipeline.bags.conftest import STRING, text
from tests.oracle_pipeline.checks.drives import AT_S, Tables, drive, sound_drive
from tests.oracle_pipeline.features.conftest import header, pose_message, write_bag


def frozen_imu(tables: Tables) -> None:
    imu = tables["imu"]
    frozen = imu.Time.between(AT_S, AT_S + 3.0)
    for column in imu.columns[1:]:
        imu.loc[frozen, column] = imu.loc[frozen, column].iloc[0]


def frozen_odometry(tables: Tables) -> None:
    odometry = tables["odom"]
    frozen = odometry.Time.between(AT_S, AT_S + 3.0)
    for column in odometry.columns[1:]:
        odometry.loc[frozen, column] = odometry.loc[frozen, column].iloc[0]


def replayed_gyroscope(tables: Tables, at_s: float = AT_S) -> None:
    imu = tables["imu"]
    first = int(np.searchsorted(imu.Time, at_s))
    earlier = imu.loc[first - 500 : first - 350, "angular_velocity.y"].to_numpy()
    imu.loc[first : first + 150, "angular_velocity.y"] = earlier


def silent_scanner(tables: Tables) -> None:
    tables["imu"] = tables["imu"][~tables["imu"].Time.between(AT_S, AT_S + 2.0)]


def held_back(tables: Tables) -> None:
    times = tables["imu"].Time.to_numpy(copy=True)
    late = (times >= AT_S) & (times < AT_S + 1.0)
    times[late] = AT_S + 1.0 + np.arange(late.sum()) * 1e-5
    tables["imu"]["Time"] = times


def gps_jump(tables: Tables) -> None:
    gps = tables["gps"]
    gps.loc[gps.Time >= AT_S, "latitude"] += 22.0 / 111_320.0


def odometry_jump(tables: Tables) -> None:
    odometry = tables["odom"]
    odometry.loc[odometry.Time >= AT_S, "pose.pose.position.x"] += 3.0


def saturated_gyroscope(tables: Tables) -> None:
    imu = tables["imu"]
    imu.loc[imu.Time.between(AT_S, AT_S + 3.0), "angular_velocity.z"] = 2.0


def impossible_latitude(tables: Tables) -> None:
    tables["gps"].loc[tables["gps"].Time >= AT_S, "latitude"] = 93.0


def nan_acceleration(tables: Tables) -> None:
    imu = tables["imu"]
    imu.loc[imu.Time.between(AT_S, AT_S + 0.1), "linear_acceleration.x"] = np.nan


def scaled_quaternion(tables: Tables) -> None:
    imu = tables["imu"]
    imu.loc[imu.Time >= AT_S, [f"orientation.{axis}" for axis in "xyzw"]] *= 0.9


def stamps_back(tables: Tables) -> None:
    odometry = tables["odom"]
    row = int(np.searchsorted(odometry.Time, AT_S))
    odometry.loc[row, "header.stamp.sec"] -= 4


def counter_back(tables: Tables) -> None:
    tables["status"].loc[tables["status"].Time >= AT_S, "count"] -= 300


def lost_messages(tables: Tables) -> None:
    tables["status"].loc[tables["status"].Time >= AT_S, "count"] += 40


FAULTS: dict[Callable[[Tables], None], tuple[str, str, float]] = {
    frozen_imu: ("stuck", "/imu", 3.0),
    frozen_odometry: ("stuck", "/odom", 3.0),
    replayed_gyroscope: ("replay", "/imu", 1.5),
    silent_scanner: ("gap", "/imu", 2.0),
    held_back: ("late_burst", "/imu", 1.0),
    gps_jump: ("jump", "/gps", 22.0 / 111_320.0),
    odometry_jump: ("jump", "/odom", 3.0),
    saturated_gyroscope: ("saturation", "/imu", 3.0),
    impossible_latitude: ("limit", "/gps", 93.0),
    nan_acceleration: ("not_finite", "/imu", 1.0),
    scaled_quaternion: ("quaternion", "/imu", 0.1),
    stamps_back: ("stamp", "/odom", 4.0),
    counter_back: ("counter", "/status", -300.0),
    lost_messages: ("lost", "/status", 40.0),
}


@pytest.mark.parametrize("alter", FAULTS, ids=lambda alter: alter.__name__)
def test_fault_is_found_with_its_topic_time_and_size(alter, tmp_path):
    check, topic, size = FAULTS[alter]
    found = check_recording(drive(tmp_path, alter))
    (fault,) = [each for each in found if (each.check, each.topic) == (check, topic)][:1]
    assert fault.size == pytest.approx(size, rel=0.1)
    assert fault.start_s == pytest.approx(AT_S, abs=0.3)
    assert f"{fault.start_s:.2f} s" in fault.text or "{" not in fault.text


def test_every_check_has_a_fault_that_it_finds():
    assert {check for check, _, _ in FAULTS.values()} == {*CHECKS, "lost"}


@given(st.integers(0, 10_000))
def test_sound_drive_has_no_fault(tmp_path_factory, seed):
    folder = tmp_path_factory.mktemp("drive")
    assert check_recording(sound_drive(folder, seed)) == []


def test_robot_that_stands_still_is_not_stuck(tmp_path):
    def stop(tables: Tables) -> None:
        frozen_odometry(tables)
        standing = tables["odom"].Time.between(AT_S, AT_S + 3.0)
        for column in [c for c in tables["odom"] if c.startswith("twist")]:
            tables["odom"].loc[standing, column] = 0.0

    assert "stuck" not in {fault.check for fault in check_recording(drive(tmp_path, stop))}


@pytest.mark.parametrize("name", ["cmd_vel", "position_setpoint"])
def test_commands_may_pause_come_again_and_leave_values_open(name, tmp_path):
    def command(tables: Tables) -> None:
        replayed_gyroscope(tables, AT_S + 4.0)
        silent_scanner(tables)
        nan_acceleration(tables)
        tables[name] = tables.pop("imu")

    checks = {fault.check for fault in check_recording(drive(tmp_path, command))}
    assert not checks & {"gap", "not_finite", "replay"}


def a_counter_that_begins_again(tables: Tables) -> None:
    tables["status"]["count"] = (tables["status"]["count"] + 65_500) % 2**16


def times_of_samples_with_a_pause(tables: Tables) -> None:
    tables["status"]["count"] *= 20_000
    tables["status"].loc[tables["status"].Time >= AT_S, "count"] += 16_000


def often_no_value(tables: Tables) -> None:
    tables["status"].loc[::3, "load"] = np.nan


def bursts(tables: Tables) -> None:
    tables["status"]["Time"] = tables["status"]["Time"] / 8.0 + 5.0 * (tables["status"].index // 60)


def outputs_before_the_start(tables: Tables) -> None:
    imu = tables.pop("imu")
    imu = imu[["Time", *imu.columns[-6:]]]
    imu.loc[imu.Time < 2.0, imu.columns[1:]] = 0.5
    tables["actuator_outputs"] = imu.rename(columns=lambda name: name.replace(".", "_"))


AS_PX4_LOGS = [
    a_counter_that_begins_again, times_of_samples_with_a_pause, often_no_value, bursts,
    outputs_before_the_start,
]  # fmt: skip


@pytest.mark.parametrize("alter", AS_PX4_LOGS, ids=lambda alter: alter.__name__)
def test_what_a_log_of_a_flight_has_is_no_fault(alter, tmp_path):
    assert check_recording(drive(tmp_path, alter)) == []


def test_numbers_that_are_lost_together_are_one_fault(tmp_path):
    def lose(tables: Tables) -> None:
        tables["imu"].loc[500:510, tables["imu"].columns[-6:]] = np.nan

    (fault,) = check_recording(drive(tmp_path, lose))
    assert (fault.check, fault.signal, fault.places) == ("not_finite", "", 11)
    assert "angular_velocity.x" in fault.text


def test_objects_that_come_and_go_are_no_fault(tmp_path):
    draw, detected = np.random.default_rng(0), message_class("geometry_msgs/msg/PoseArray")
    seen = []
    for time_s in np.arange(0.0, 20.0, 0.05):
        places = 9.0 * draw.random((draw.integers(3), 2))
        poses = [pose_message(x, y, 0.0) for x, y in places]
        seen.append((time_s, "/objects", detected(header(time_s, "map"), poses)))
    write_bag(tmp_path / "bag", seen)
    assert check_recording(tmp_path / "bag") == []


def test_a_last_message_without_numbers_is_no_fault(tmp_path):
    def end(tables: Tables) -> None:
        tables["status"].loc[tables["status"].index[-1], "load"] = np.nan

    assert check_recording(drive(tmp_path, end)) == []


@pytest.mark.parametrize(("table", "checks"), [("status", set()), ("imu", {"not_finite"})])
def test_blank_cells_at_the_end_are_a_fault_of_ros_messages_only(table, checks, tmp_path):
    def end(tables: Tables) -> None:
        column = {"status": "load", "imu": "linear_acceleration.x"}[table]
        tables[table].loc[tables[table].index[-5:], column] = np.nan

    assert {fault.check for fault in check_recording(drive(tmp_path, end))} == checks


def test_gap_in_all_topics_is_one_fault_of_the_recording(tmp_path):
    def stop_recorder(tables: Tables) -> None:
        for number in range(9):
            tables[f"event{number}"] = tables["gps"].iloc[[number]]  # too few for a gap
        for name, table in tables.items():
            tables[name] = table[~table.Time.between(AT_S, AT_S + 4.0)]

    found = check_recording(drive(tmp_path, stop_recorder))
    (fault,) = [fault for fault in found if fault.check == "gap"]
    assert fault.topic == ""
    assert "the recorder stood still" in fault.text


def test_gaps_at_different_times_stay_those_of_their_topics(tmp_path):
    def pause(tables: Tables) -> None:
        for number, name in enumerate(list(tables)):  # four topics, an even number
            table, begin_s = tables[name], 2.0 + 4.0 * number
            tables[name] = table[~table.Time.between(begin_s, begin_s + 1.5)]

    found = check_recording(drive(tmp_path, pause))
    gaps = [fault for fault in found if fault.check == "gap"]
    assert {fault.topic for fault in gaps} == {"/imu", "/odom", "/gps", "/status"}
    assert all(fault.size > 1.0 for fault in gaps)


def test_command_reports_faults_in_all_forms(tmp_path):
    bad, good = drive(tmp_path / "bad", frozen_imu), sound_drive(tmp_path / "good", 0)
    junit, page = tmp_path / "checks.xml", tmp_path / "checks.html"
    arguments = ["check", str(bad), str(good), "--junit", str(junit), "--page", str(page)]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 1
    assert result.stdout.splitlines()[-1] == "1 with faults, 1 without, 0 not checked"
    suite = ElementTree.parse(junit).getroot()  # noqa: S314 -- our own file
    assert suite.get("failures") == "1"
    assert "do not change for 3 s" in page.read_text()
    result = CliRunner().invoke(main, ["check", str(good), "--format", "json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout)["recordings"][0]["faults"] == []


def test_unreadable_recording_is_named_and_the_others_are_checked(tmp_path):
    good = sound_drive(tmp_path / "good", 0)
    (tmp_path / "broken.mcap").write_bytes(b"no bag")
    result = CliRunner().invoke(main, ["check", str(tmp_path / "broken.mcap"), str(good)])
    assert result.exit_code == 2
    assert "broken.mcap: could not be checked" in result.stdout
    assert "good: no fault found" in result.stdout


@pytest.mark.slow
def test_score_tells_the_faults_of_a_recording_beside_its_verdict(tmp_path):
    for seed in range(3):
        sound_drive(tmp_path / "good" / str(seed), seed)
    faulty, sound = drive(tmp_path / "faulty", frozen_imu, 3), sound_drive(tmp_path / "sound", 4)
    words = ["score", str(faulty), str(sound), "--reference", str(tmp_path / "good")]
    done = CliRunner().invoke(main, [*words, "--far", "0.25", "--format", "json"])
    told = [
        [note for note in verdict["notes"] if note.startswith("Check: ")]
        for verdict in json.loads(done.stdout)["recordings"]
    ]
    assert [fault.text for fault in check_recording(faulty)] == [
        note.removeprefix("Check: /imu: ").removesuffix(".") for note in told[0]
    ]
    assert told[1] == []


def test_a_clock_that_is_set_back_is_a_fault(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for name in ("/one", "/two"):
            bag.add_topic(name, STRING, ())
        for tick in range(100):
            stamp_ns = 10**12 + tick * 10**8 - (2 * 10**9 if tick >= 60 else 0)
            bag.write("/one", stamp_ns, text("a"))
            bag.write("/two", stamp_ns + 1, text("b"))
    (fault,) = (each for each in check_recording(tmp_path / "bag") if each.check == "clock")
    assert fault.text == "the recorder's clock was set back by 1.9 s at 5.90 s"


FIELDS = [
    ("pose.position.x", "m"), ("longitude", "deg"), ("angle", "rad"), ("count", ""), ("level", ""),
    *((f"orientation.{axis}", "") for axis in "xyzw"), ("angular_velocity.z", "rad/s"),
]  # fmt: skip
SPECIAL = [np.nan, np.inf, -np.inf, 1.7e308, -1.7e308, 180.0, -180.0, 5e-324, 2.0**53]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=200)
def test_whatever_numbers_a_topic_has_each_check_ends_and_its_faults_lie_within(seed):
    rng = np.random.default_rng(seed)
    number = int(rng.integers(1, 300))
    times_ns = np.cumsum(rng.choice([0, 1, 10**7, 10**9], number, p=rng.dirichlet([1, 1, 1, 1])))
    times_ns = np.repeat(times_ns, rng.integers(1, 4))[:number]  # of two objects or three
    shape = (number, len(FIELDS))
    pool = np.append(rng.normal(0.0, 10.0 ** rng.integers(-3, 6), 3), rng.choice(SPECIAL, 2))
    values = np.select(
        [rng.random(shape) < rng.choice([0.0, 0.1]), rng.random(shape[1]) < rng.choice([0.1, 0.9])],
        [rng.choice(pool, shape), rng.choice(pool, (3, shape[1]))[np.arange(number) % 3]],
        np.cumsum(rng.normal(size=shape), axis=0),
    )
    signals = Signals("/t", *zip(*FIELDS, strict=True), times_ns=times_ns, values=values)
    stamps_ns = rng.permutation(times_ns) if rng.random() < 0.3 else times_ns
    topic = CheckedTopic("/t", "a/B", times_ns / 1e9, stamps_ns, (signals,))
    with np.errstate(all="ignore"):
        faults = [fault for check in CHECKS.values() for fault in check(topic)]
    for fault in faults:
        assert times_ns[0] / 1e9 <= fault.start_s <= fault.end_s <= times_ns[-1] / 1e9, fault
        assert fault.places > 0
        assert "nan" not in fault.text, fault
