"""One contract over all readers of logs: a log becomes a bag with the same numbers."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from rosbags.highlevel import AnyReader

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.errors import BagError, OracleError
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.run_directory import MANIFEST_FILE
from oracle_pipeline.cli import main
from oracle_pipeline.logs.formats import logs_at, open_as_bag, read_log, recordings_below
from oracle_pipeline.logs.layout import LAYOUT_FILE, Layout
from oracle_pipeline.logs.log import LogError
from oracle_pipeline.logs.tables import guess_layout, read_tables
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.logs import samples

KINDS = list(samples.SAMPLES)


def first_numbers(bag: BagReader, topic: str, field: str) -> list[float]:
    """Return a field of all messages; of an array its first number."""
    messages = [bag.deserialize(message) for message in bag.messages([topic])]
    return [float(np.ravel(getattr(message, field))[0]) for message in messages]


@pytest.mark.parametrize("kind", KINDS)
def test_log_is_read_as_a_bag_with_the_same_times_and_numbers(kind, tmp_path):
    write, topic, field = samples.SAMPLES[kind]
    offset = 1.0 if kind == "lerobot" else 0.0  # its second episode
    with open_run(write(tmp_path)) as run:
        assert run.bag.topics[topic].count == samples.COUNT
        assert run.duration_s == pytest.approx(samples.TIMES_S[-1], abs=1e-6)
        found = first_numbers(run.bag, topic, field)
    assert found == pytest.approx(samples.SIGNAL + offset, abs=1e-6)


def test_what_px4_published_before_the_log_began_is_at_its_beginning(tmp_path):
    before = int((samples.TIMES_S < 1.0).sum())
    with open_run(samples.ulog(tmp_path, begin_us=1_000_000)) as run:
        stamps = [message.stamp_ns for message in run.bag.messages(["/vehicle_attitude"])]
    assert stamps[: before + 1] == [10**9] * (before + 1)
    assert len(stamps) == samples.COUNT


def test_a_scan_in_json_counts_whatever_its_length(tmp_path):
    def scan(value):
        return {"ranges": [1.0] * 300 + [2.0 + value] * (60 if value < 0.5 else 61)}

    with open_run(samples.mcap_json(tmp_path, scan)) as run:
        rows = [run.bag.deserialize(message).ranges for message in run.bag.messages()]
    found = np.array(rows)
    np.testing.assert_array_equal(found[:, 359], 2.0 + samples.SIGNAL)
    np.testing.assert_array_equal(np.isnan(found[:, 360]), samples.SIGNAL < 0.5)


@pytest.mark.parametrize("field", [b"TimeMS", b"T"])
def test_dataflash_of_old_releases_has_its_time_in_milliseconds(field, tmp_path):
    with open_run(samples.dataflash(tmp_path, field, 1e-3)) as run:
        assert run.bag.topics["/ATT"].count == samples.COUNT
        assert run.duration_s == pytest.approx(samples.TIMES_S[-1], abs=1e-6)


def test_a_data_set_is_given_to_commands_as_its_episodes(tmp_path):
    dataset = samples.lerobot(tmp_path).parent
    done = CliRunner().invoke(main, ["check", str(dataset), "--format", "json"])
    names = [Path(each["recording"]).name for each in json.loads(done.stdout)["recordings"]]
    assert names == ["episode_000000", "episode_000001"]


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_log_is_refused_in_one_line_or_read_in_part(kind, tmp_path, capfd):
    write, topic, _ = samples.SAMPLES[kind]
    path = write(tmp_path)
    file = next(path.parent.glob("data/*/*1.parquet")) if kind == "lerobot" else path
    content = file.read_bytes()
    cuts = (content[:size] for size in (20, len(content) // 3, len(content) - 7))
    no_text = (content.replace(name, b"r\xedll") for name in (b"roll", b"state"))
    for damaged in (*cuts, *no_text):
        file.write_bytes(damaged)
        counts, refusal = _counts(path)
        assert counts.get(topic, 0) <= samples.COUNT
        assert bool(counts) != bool(refusal)
        assert "\n" not in refusal
        assert capfd.readouterr() == ("", "")


def test_a_ulog_that_its_parser_reads_without_end_is_refused(tmp_path):
    path = samples.SAMPLES["ulog"][0](tmp_path)
    back = b"\x60\xea\x01"  # a message of 60,000 bytes, from whose end pyulog goes back by as many
    path.write_bytes(path.read_bytes()[:16] + b"\0\0I" * 25_000 + back)
    with pytest.raises(LogError, match="its parser comes to no end"):
        read_log(path)


def test_a_message_of_dataflash_with_a_damaged_time_is_left_out(tmp_path):
    path = samples.SAMPLES["dataflash"][0](tmp_path)
    path.write_bytes(path.read_bytes()[:-12] + b"\xff" * 8 + bytes(4))  # time and number
    log = read_log(path)
    assert len(log.topics[0].times_ns) == samples.COUNT - 1
    assert log.notes == ["/ATT: 1 messages with a damaged time are not used."]


@pytest.mark.parametrize("version", [1, 2])
def test_telemetry_is_read_past_what_is_damaged(version, tmp_path):
    path = samples.telemetry(tmp_path, version)
    content = path.read_bytes()
    size = len(content) // samples.COUNT
    damaged = size + 20  # in the second message
    path.write_bytes(b"\xfd\xfe" + content[:damaged] + b"\xfe" + content[damaged + 1 :])
    log = read_log(path)
    (topic,) = log.topics
    assert len(topic.times_ns) == samples.COUNT - 1
    assert topic.times_ns[0] == samples.BEGIN_US * 1000
    assert log.notes == [f"{size + 2} bytes are damaged or cut off and are not used."]


def test_telemetry_of_others_and_of_several_sensors_has_topics_of_its_own(tmp_path):
    beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    first, second = (
        mavlink.MAVLink_distance_sensor_message(0, 20, 700, 100 + n, 0, n, 25, 0) for n in range(2)
    )
    setting = mavlink.MAVLink_param_value_message(b"RATE", 1.0, 9, 1, 0)
    sent = [(beat, 255, 190), (beat, 7, 1), (first, 7, 1), (second, 7, 1), (setting, 7, 1)]
    packets = [samples.packet(n, *each) for n in range(3) for each in sent]
    path = tmp_path / "flight.TLOG"
    path.write_bytes(b"".join(packets))
    topics = {topic.name: topic.columns for topic in read_log(path).topics}
    names = {"/DISTANCE_SENSOR_0", "/DISTANCE_SENSOR_1", "/HEARTBEAT", "/HEARTBEAT_255_190"}
    assert topics.keys() == names
    assert topics["/DISTANCE_SENSOR_1"]["current_distance"].tolist() == [101] * 3


def _counts(path: Path) -> tuple[dict[str, int], str]:
    """Return the number of messages of each topic, or the error."""
    try:
        with open_run(path) as run:
            return {name: topic.count for name, topic in run.bag.topics.items()}, ""
    except OracleError as error:
        return {}, str(error)


def test_opened_log_leaves_nothing_behind(tmp_path):
    with open_run(samples.csv(tmp_path)) as run:
        bag = run.bag.path
        assert bag.exists()
    assert not bag.exists()


@pytest.mark.parametrize("command", ["learn", "invariants"])
def test_single_episodes_are_learned_from(command, tmp_path):
    dataset, output = samples.lerobot(tmp_path).parent, tmp_path / "normal.card"
    episodes = [str(dataset / f"episode_{number:06d}") for number in range(2)]
    result = CliRunner().invoke(main, [command, *episodes, "--output", str(output)])
    told = {"learn": "count as 2 blocks", "invariants": "at least 3 normal runs, but there are 2"}
    assert told[command] in result.output


def test_versions_2_and_3_of_lerobot_give_the_same_episode(tmp_path):
    second, third = (read_log(samples.lerobot(tmp_path, version)) for version in (2, 3))
    for one, other in zip(second.topics, third.topics, strict=True):
        assert one.name == other.name
        for name in one.columns:
            np.testing.assert_array_equal(one.columns[name], other.columns[name])


def test_episodes_of_a_data_set_are_its_recordings(tmp_path):
    dataset = samples.lerobot(tmp_path).parent
    assert [path.name for path in recordings_below(dataset)] == ["episode_000000", "episode_000001"]


@given(st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=20), st.integers(1, 3))
def test_every_number_of_a_table_is_in_its_bag(tmp_path_factory, numbers, columns):
    folder = tmp_path_factory.mktemp("table")
    frame = pd.DataFrame({f"c{n}": np.array(numbers) * (n + 1) for n in range(columns)})
    frame.insert(0, "timestamp_ms", np.arange(len(numbers)) * 10)
    frame.to_csv(folder / "t.csv", index=False)
    bag, _, scratch = open_as_bag(folder / "t.csv")
    with BagReader(bag) as reader:
        for n in range(columns):
            expected = pd.read_csv(folder / "t.csv")[f"c{n}"].tolist()
            assert first_numbers(reader, "/log", f"c{n}") == expected
    scratch.cleanup()


def exported_drive(folder: Path, speed: float = 0.2) -> Path:
    """Write a drive as `rosbag` exports topics: one CSV for each, with the names of fields."""
    folder.mkdir()
    count = 200
    pose = {f"position.{axis}": np.zeros(count) for axis in "yz"}
    pose |= {f"orientation.{axis}": np.full(count, float(axis == "w")) for axis in "xyzw"}
    time = np.arange(count) * 0.05
    odometry = {"Time": time, "header.seq": np.arange(count), "header.frame_id": "odom"}
    odometry |= {"child_frame_id": "base_link", "pose.pose.position.x": time * speed}
    odometry |= {f"pose.pose.{name}": values for name, values in pose.items()}
    odometry |= {"pose.covariance": [str((0.0,) * 36)] * count}
    twist = {f"{part}.{axis}": np.zeros(count) for part in ("linear", "angular") for axis in "xyz"}
    twist["linear.x"] = np.full(count, speed)
    odometry |= {f"twist.twist.{name}": values for name, values in twist.items()}
    pd.DataFrame(odometry).to_csv(folder / "odom.csv", index=False)
    pd.DataFrame({"Time": time} | twist).to_csv(folder / "cmd_vel.csv", index=False)
    return folder


def test_exported_topics_get_their_types_back(tmp_path):
    with open_run(exported_drive(tmp_path / "drive")) as run:
        types = {name: topic.msgtype for name, topic in run.bag.topics.items()}
        first = run.bag.deserialize(next(run.bag.messages(["/odom"])))
    assert types == {"/odom": "nav_msgs/msg/Odometry", "/cmd_vel": "geometry_msgs/msg/Twist"}
    assert first.header.frame_id == "odom"
    assert first.pose.covariance.shape == (36,)


@pytest.mark.parametrize("name", ["flight_2018-07-18_1_failure", "drive"])
def test_what_rostopic_echo_wrote_is_the_same_drive(name, tmp_path):
    drive = exported_drive(tmp_path / "exported")
    echoed = tmp_path / name
    echoed.mkdir()
    for table in drive.glob("*.csv"):
        frame = pd.read_csv(table)
        frame.insert(0, "%time", (frame.pop("Time") * 1e9).round().astype("int64") + 10**18)
        if "pose.covariance" in frame:
            frame = frame.drop(columns="pose.covariance").assign(
                **{f"pose.covariance{n}": 0.0 for n in range(36)},
                **{"header.stamp": frame["%time"]}, child_frame_id=""
            )  # fmt: skip
        frame = frame.rename(columns=lambda each: each if each == "%time" else f"field.{each}")
        frame.to_csv(echoed / f"{name}-{table.name}", index=False)
    expected, found = read_tables(drive), read_tables(echoed)
    for one, other in zip(expected.topics, found.topics, strict=True):
        assert (one.name, one.msgtype) == (other.name, other.msgtype)
        np.testing.assert_allclose(other.times_ns - 10**18, one.times_ns)
        for field, values in one.columns.items():
            np.testing.assert_array_equal(other.columns[field], values)
    stamped = next(topic for topic in found.topics if topic.name == "/odom")
    assert stamped.columns["header.stamp.sec"].tolist() == [10**9 + n // 20 for n in range(200)]


def test_what_ros2_topic_echo_wrote_has_its_names_and_its_type_back(tmp_path):
    numbers = {"orientation": 4, "orientation_covariance": 9, "angular_velocity": 3, "": 9 + 3 + 9}
    row = list(map(float, range(sum(numbers.values()))))
    stamps = [(1648214153 + n // 4, n % 4 * 250_000_000) for n in range(8)]
    rows = (",".join(map(str, [*stamp, "imu_link", *row])) for stamp in stamps)
    (tmp_path / "imu.csv").write_text("\n".join(rows) + "\n")
    with open_run(tmp_path / "imu.csv") as run:
        messages = [run.bag.deserialize(message) for message in run.bag.messages(["/log"])]
        assert run.duration_s == pytest.approx(1.75)
    assert [(m.header.stamp.sec, m.header.stamp.nanosec) for m in messages] == stamps
    assert messages[0].header.frame_id == "imu_link"
    assert (messages[0].orientation.w, messages[0].angular_velocity.y) == (3.0, 14.0)
    assert messages[0].linear_acceleration_covariance[8] == row[-1]


def test_what_rostopic_echo_wrote_of_a_scanner_is_a_scan(tmp_path):
    stamps = np.arange(5) * 200_000_000 + 10**18
    scan = {"%time": stamps, "field.header.stamp": stamps, "field.header.frame_id": "base_scan"}
    single = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time")
    scan |= {f"field.{name}": 0.1 for name in (*single, "range_min", "range_max")}
    scan |= {f"field.ranges{n}": [1.0, np.inf, 2.0, 3.0, n] for n in range(180)}
    pd.DataFrame(scan).to_csv(tmp_path / "scan.csv", index=False)
    with open_run(tmp_path / "scan.csv") as run:
        last = [run.bag.deserialize(message) for message in run.bag.messages(["/log"])][-1]
    assert type(last).__name__.endswith("LaserScan")
    np.testing.assert_array_equal(last.ranges, np.arange(180.0))
    assert last.header.frame_id == "base_scan"
    assert last.header.stamp.nanosec == 800_000_000


def test_commands_read_logs(tmp_path):
    drive = exported_drive(tmp_path / "drive")
    result = CliRunner().invoke(main, ["features", str(drive), "--format", "json"])
    assert result.exit_code == 0, result.output
    row = json.loads(result.stdout)["rows"][0]
    assert row["contextual.speed"] == pytest.approx(0.2, rel=0.05)


def test_commands_read_every_recording_of_a_folder(tmp_path):
    flights = tmp_path / "flights"
    flights.mkdir()
    for number in range(2):
        samples.csv(flights).rename(flights / f"flight{number}.csv")
    features = CliRunner().invoke(main, ["features", str(flights), "--format", "json"])
    assert len(json.loads(features.stdout)["rows"]) == 2
    check = CliRunner().invoke(main, ["check", str(flights), "--format", "json"])
    assert len(json.loads(check.stdout)["recordings"]) == 2


def test_import_writes_a_bag_that_is_read_as_the_log(tmp_path):
    drive = exported_drive(tmp_path / "drive")
    result = CliRunner().invoke(main, ["import", str(drive), "--out", str(tmp_path / "bags")])
    assert result.exit_code == 0, result.output
    with open_run(drive) as log, open_run(tmp_path / "bags" / "drive") as bag:
        assert [(m.topic, m.data) for m in log.bag.messages()] == [
            (m.topic, m.data) for m in bag.bag.messages()
        ]


@pytest.mark.parametrize("kind", KINDS)
def test_other_tools_open_an_imported_bag(kind, tmp_path):
    write, topic, field = samples.SAMPLES[kind]
    log = write(tmp_path)
    result = CliRunner().invoke(main, ["import", str(log), "--out", str(tmp_path / "bags")])
    assert result.exit_code == 0, result.output
    with AnyReader([tmp_path / "bags" / log.name.removesuffix(log.suffix)]) as bag:
        messages = [
            bag.deserialize(data, c.msgtype) for c, _, data in bag.messages() if c.topic == topic
        ]
    assert len(messages) == samples.COUNT
    assert all(np.isfinite(getattr(message, field)).all() for message in messages)


def test_guessed_layout_reads_the_same_as_none(tmp_path):
    drive = exported_drive(tmp_path / "drive")
    without = read_tables(drive)
    (drive / LAYOUT_FILE).write_text(guess_layout(drive).text())
    with_layout = read_tables(drive)
    for one, other in zip(without.topics, with_layout.topics, strict=True):
        assert (one.name, one.msgtype) == (other.name, other.msgtype)
        np.testing.assert_array_equal(one.times_ns, other.times_ns)
        assert list(one.columns) == list(other.columns)


def test_layout_names_topic_type_time_and_units(tmp_path):
    file = tmp_path / "gyro.csv"
    pd.DataFrame({"tick": [0, 10, 20], "gz": [90.0, 0.0, -90.0], "note": [1, 2, 3]}).to_csv(
        file, index=False
    )
    (tmp_path / LAYOUT_FILE).write_text(
        "topics:\n"
        "- file: gyro*.csv\n"
        "  topic: /imu\n"
        "  type: sensor_msgs/msg/Imu\n"
        "  time: {column: tick, unit: ms}\n"
        "  fields: {angular_velocity.z: {column: gz, unit: deg/s}}\n"
    )
    with open_run(file) as run:
        messages = [run.bag.deserialize(message) for message in run.bag.messages(["/imu"])]
        assert run.duration_s == pytest.approx(0.02)
    assert [m.angular_velocity.z for m in messages] == pytest.approx([math.pi / 2, 0, -math.pi / 2])
    assert messages[1].header.stamp.nanosec == 10_000_000


def test_numbered_columns_fill_a_sequence_of_a_ros_type(tmp_path):
    pd.DataFrame({"t": [0.0, 0.1], "ranges_0": [1.0, 2.0], "ranges_1": [3.0, 4.0]}).to_csv(
        tmp_path / "scan.csv", index=False
    )
    (tmp_path / LAYOUT_FILE).write_text(
        "topics: [{file: scan.csv, topic: /scan, type: sensor_msgs/msg/LaserScan}]"
    )
    with open_run(tmp_path / "scan.csv") as run:
        scans = [run.bag.deserialize(message) for message in run.bag.messages(["/scan"])]
    assert [scan.ranges.tolist() for scan in scans] == [[1.0, 3.0], [2.0, 4.0]]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("topics: [{}]", "'file' is a required property"),
        ("topics: [{file: a.csv, time: {}}]", "is not valid"),
        ("recording: both", "is not one of"),
        ("topics: [{file: a.csv, type: no_msgs/msg/Such}]", "no_msgs/msg/Such, which is not known"),
        ("a: &a [*a]", "alias"),
        ("a: !!python/object:os.system {}", "tag"),
        (
            "topics: [{file: a, type: sensor_msgs/msg/Imu, fields: {x: {column: x, unit: ell}}}]",
            "unit 'ell'",
        ),
    ],
)
def test_bad_layout_is_refused_with_its_fault(text, fault, tmp_path):
    file = tmp_path / LAYOUT_FILE
    file.write_text(text)
    with pytest.raises(LogError, match=fault):
        Layout.load(file)


@pytest.mark.parametrize(
    ("name", "times", "unit"),
    [
        ("time", np.arange(5) * 0.01, "s"),
        ("timestamp", np.arange(5) * 9.88, "ms"),
        ("timestamp", np.arange(5) * 10_000, "us"),
        ("t_us", np.arange(5) * 1.0, "us"),
        ("Time", 1.7e9 + np.arange(5), "s"),
        ("Time", 1.7e18 + np.arange(5) * 1e7, "ns"),
    ],
)
def test_unit_of_time_is_guessed_and_told(name, times, unit, tmp_path):
    file = tmp_path / "t.csv"
    pd.DataFrame({name: times, "x": np.arange(5)}).to_csv(file, index=False)
    assert f"{name} is taken as the time in {unit}." in " ".join(read_tables(file).notes)


TABLE = pd.DataFrame({"time": np.arange(20) * 0.05, "roll [°]": np.arange(20) ** 2 / 8 - 0.5})
DATED = TABLE.assign(time=pd.to_datetime(1.7e9 + TABLE["time"], unit="s"))
_SECONDS = (TABLE["time"] + 1.7e9) // 1
SPLIT = TABLE.assign(time=_SECONDS.astype(int), rest=round(TABLE["time"] % 1 * 1e9).astype(int))
CLOCK = DATED["time"].dt.strftime("%H:%M:%S.%f")
WRITERS = {
    "commas": TABLE.to_csv(index=False),
    "an index": TABLE.to_csv(),
    "tabs": TABLE.to_csv(index=False, sep="\t"),
    "spaces": TABLE.rename(columns={"roll [°]": "roll_[°]"}).to_csv(index=False, sep=" "),
    "a European spreadsheet": "sep=;\n" + TABLE.to_csv(index=False, sep=";", decimal=","),
    "remarks": "# robot 7\n\n" + TABLE.to_csv(index=False),
    "a header of NumPy": "# " + TABLE.to_csv(index=False),
    "units": TABLE.to_csv(index=False).replace("\n", "\ns,deg\n", 1),
    "a name like a time": TABLE.rename(columns={"time": "ros_time (s)"}).to_csv(index=False),
    "dates": DATED.to_csv(index=False),
    "times of day": TABLE.assign(time=CLOCK).to_csv(index=False),
    "dates beside times of day": TABLE.assign(Date="2023-11-14", time=CLOCK).to_csv(index=False),
    "commas at the end": TABLE.to_csv(index=False).replace("\n", ",\n").replace(",\n", "\n", 1),
    "columns without a value": "stamp,"
    + TABLE.to_csv(index=False).replace("\n", ",\n,").removesuffix(","),
    "row names without a name": TABLE.to_csv(sep="\t").removeprefix("\t"),
    "seconds and nanoseconds": SPLIT.rename(columns={"time": "sec", "rest": "nanosec"}).to_csv(),
    "stamps in two columns": SPLIT.rename(
        columns={"time": "header.stamp.secs", "rest": "header.stamp.nsecs"}
    ).to_csv(index=False),
    "other quotes and ends of lines": TABLE.to_csv(index=False, quoting=1, lineterminator="\r\n"),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("text", WRITERS.values(), ids=WRITERS)
def test_a_table_is_read_the_same_however_a_program_writes_it(text, encoding, tmp_path):
    file = tmp_path / "t.tsv"
    file.write_bytes(text.encode(encoding))
    (topic,) = read_log(file).topics
    assert [name.replace("_", " ") for name in topic.columns] == ["roll [°]"]
    np.testing.assert_array_equal(*topic.columns.values(), TABLE["roll [°]"])
    np.testing.assert_allclose(topic.times_ns - topic.times_ns[0], TABLE["time"] * 1e9, atol=2e3)


def test_a_column_that_counts_rows_is_a_signal_only_if_the_layout_names_it(tmp_path):
    table = pd.DataFrame({"time": np.arange(9) * 0.1, "frame": np.arange(9), "x": 1.5})
    table.to_csv(tmp_path / "t.csv", index=False)
    assert list(read_tables(tmp_path / "t.csv").topics[0].columns) == ["x"]
    (tmp_path / LAYOUT_FILE).write_text("topics: [{file: t.csv, fields: {n: frame}}]")
    assert list(read_tables(tmp_path / "t.csv").topics[0].columns) == ["n"]


@pytest.mark.parametrize("name", ["stamp", None])
def test_the_time_may_be_the_index_of_a_table(name, tmp_path):
    DATED.set_index("time").rename_axis(name).to_parquet(tmp_path / "t.parquet")
    (topic,) = read_tables(tmp_path / "t.parquet").topics
    assert list(topic.columns) == ["roll [°]"]
    np.testing.assert_allclose(topic.times_ns - topic.times_ns[0], TABLE["time"] * 1e9, atol=300.0)


def test_a_table_without_names_has_numbered_columns(tmp_path):
    file = tmp_path / "t.csv"
    file.write_text(TABLE.to_csv(index=False, header=False))
    with pytest.raises(BagError, match="no column of time, but column_1, column_2"):
        read_tables(file)
    (tmp_path / LAYOUT_FILE).write_text("topics: [{file: t.csv, time: {column: column_1}}]")
    (topic,) = read_tables(file).topics
    np.testing.assert_array_equal(topic.columns["column_2"], TABLE["roll [°]"])


def test_dates_of_antiquity_are_no_times(tmp_path):
    file = tmp_path / "t.csv"
    file.write_text("time,x\n0001-01-01 00:00:00,1\n0001-01-01 00:00:01,2\n")
    with pytest.raises(BagError, match="time"):
        read_tables(file)


@pytest.mark.parametrize("time", ["1e300", "-1e300", "inf", "nan", ""])
def test_a_time_that_no_clock_shows_is_none(time, tmp_path):
    file = tmp_path / "t.csv"
    file.write_text(f"time,x\n0,1\n0.25,2\n{time},3\n0.75,4\n1,5\n")
    log = read_tables(file)
    assert (log.topics[0].times_ns == [0, 250_000_000, 750_000_000, 1_000_000_000]).all()
    assert "1 rows without a time are not used." in log.notes


def test_label_is_never_a_signal(tmp_path):
    file = tmp_path / "t.csv"
    pd.DataFrame({"time": [0, 1], "x": [1, 2], "Label": [0, 1]}).to_csv(file, index=False)
    log = read_tables(file)
    assert list(log.topics[0].columns) == ["x"]
    assert "Label looks like a label" in " ".join(log.notes)


def test_folder_is_topics_of_one_recording_or_recordings_of_one_topic(tmp_path):
    flights = tmp_path / "flights"
    flights.mkdir()
    for number in range(3):
        samples.csv(flights).rename(flights / f"flight{number}.csv")
    assert len(list(logs_at(flights))) == 3
    for number, file in enumerate(sorted(flights.iterdir())):
        frame = pd.read_csv(file).assign(pitch=0.5, yaw=0.5, **{f"debug{number}": 0.5})
        frame.to_csv(file, index=False)
    assert len(list(logs_at(flights))) == 3
    drive = exported_drive(tmp_path / "drive")
    assert list(logs_at(drive)) == [drive]
    assert "Its tables are taken as the topics of one recording." in read_log(drive).notes
    arms = tmp_path / "arms"
    for run in ("monday", "tuesday"):
        (arms / run).mkdir(parents=True)
        for motor in (1, 2):
            samples.csv(arms / run).rename(arms / run / f"motor_{motor}.csv")
    assert list(recordings_below(arms)) == [arms / "monday", arms / "tuesday"]
    for day in ("monday", "tuesday"):
        for motor in (1, 2):
            (arms / day / f"motor_{motor}.csv").rename(arms / day / f"run_{motor}.csv")
    assert len(list(recordings_below(arms))) == 4


def test_table_of_features_is_no_log(tmp_path):
    keys = {"run_id": ["a"], "mode": ["m"], "label": ["normal"], "block": [0], "time": [0.0]}
    pd.DataFrame(keys).to_parquet(tmp_path / "features.parquet")
    assert list(recordings_below(tmp_path)) == []


def test_tables_that_the_pipeline_writes_into_a_root_are_no_logs(tmp_path):
    run = layout.run_folder(tmp_path, "fake_object", "run000")
    run.mkdir(parents=True)
    (run / MANIFEST_FILE).touch()
    part = layout.report_part(tmp_path, "pairwise_report") / "table.parquet"
    for table in (part, layout.dataset(tmp_path, "truth")):
        table.parent.mkdir(parents=True)
        pd.DataFrame({"auc": [0.5, 1.0]}).to_parquet(table)
    assert list(recordings_below(tmp_path)) == [run]
    assert list(recordings_below(part.parent)) == [part]  # as anywhere else


def test_table_without_time_says_how_to_name_it(tmp_path):
    file = tmp_path / "t.csv"
    pd.DataFrame({"x1": [1, 2]}).to_csv(file, index=False)
    with pytest.raises(BagError, match="no column of time.*oracle_log.yaml"):
        read_log(file)
    (tmp_path / LAYOUT_FILE).write_text("topics: [{file: t.csv, time: {rate: 50}}]")
    (topic,) = read_log(file).topics
    assert topic.times_ns.tolist() == [0, 20_000_000]
    assert list(topic.columns) == ["x1"]
