"""Signals: every number of every message has statistics, and is treated as what it is."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from oracle_pipeline import features
from oracle_pipeline.bags.cdr import ENCAPSULATION
from oracle_pipeline.bags.types import TypeDefinition, message_class
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.datasets import signal_columns
from oracle_pipeline.features import build_manager
from oracle_pipeline.features.engine.spans import Span
from oracle_pipeline.features.signals import collector
from oracle_pipeline.features.signals.collector import CUT, MOST_SIGNALS, Signals
from oracle_pipeline.features.signals.statistics import FEWEST_HELD, OF_RUN, OF_STEPS, SignalTable
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.features.conftest import write_bag
from tests.oracle_pipeline.features.scenery import header
from tests.oracle_pipeline.features.test_transforms import transform

MANAGER = build_manager()
COUNT = 200
TIME_S = np.arange(COUNT) * 0.05


def signals_of(path) -> dict[str, float]:
    """Return the statistics of a recording's signals."""
    with open_run(path) as run:
        row = features.extract(run, MANAGER).run
    return row[list(signal_columns(row))].iloc[0].to_dict()


def logged(folder, **columns):
    """Write a table of 10 s as a log."""
    path = folder / "log.csv"
    pd.DataFrame({"time": TIME_S, **columns}).to_csv(path, index=False)
    return path


@pytest.mark.parametrize("per_window", [False, True])
def test_a_field_may_be_named_as_the_rate_of_a_counter_is(per_window):
    names, times_ns = ("count", "count.rate"), np.arange(COUNT) * 50_000_000
    values = np.column_stack([np.arange(COUNT), np.full(COUNT, 7.0)])
    table = SignalTable([Signals("/log", names, ("", ""), times_ns, values)])
    found = table.values(Span(0, 10_000_000_000), per_window=per_window)
    (rate,) = [value for name, value in found.items() if name.endswith("count.rate.mean")]
    assert rate == 7.0


@given(hnp.arrays(np.float64, (6, 2)), st.booleans())
def test_no_statistic_of_any_numbers_is_infinite(values, per_window):
    signals = Signals("/log", ("a", "b"), ("", "rad"), np.arange(6), values)
    with np.errstate(all="ignore"):
        found = SignalTable([signals]).values(Span(0, 10), per_window=per_window)
    assert not np.isinf([*found.values()]).any()


@pytest.mark.parametrize(("count", "told"), [(1, {"mean"}), (2, {"mean", "min", "max"})])
def test_one_number_has_a_mean_and_a_few_have_a_range_too(count, told):
    signals = Signals("/log", ("a",), ("",), np.arange(count), np.full((count, 1), 3.0))
    found = SignalTable([signals]).values(Span(0, 10))
    finite = {name.rpartition(".")[2] for name, value in found.items() if np.isfinite(value)}
    assert finite == {*told, "missing"}


@given(st.integers(0, 1000), st.floats(0.1, 1e3), st.floats(-1e3, 1e3))
def test_statistics_are_those_of_numpy(tmp_path_factory, seed, scale, level):
    values = level + scale * np.random.default_rng(seed).normal(size=COUNT)
    centred = values - values.mean()
    found = signals_of(logged(tmp_path_factory.mktemp("log"), a=values))
    expected = {
        "mean": values.mean(), "std": values.std(), "min": values.min(), "max": values.max(),
        "change": np.abs(np.diff(values)).mean(), "missing": 0.0, "held": 1.0 / COUNT,
        "autocorrelation": np.sum(centred[1:] * centred[:-1]) / np.sum(centred**2),
    }  # fmt: skip
    assert set(expected) == set(OF_RUN)
    for statistic, value in expected.items():
        assert found[f"signals./log/a.{statistic}"] == pytest.approx(value, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("statistic", ["mean", *OF_STEPS])
@pytest.mark.parametrize("period_s", [0.004, 0.008, 0.063])
def test_numbers_do_not_depend_on_how_many_messages_are_passed_over(
    tmp_path, monkeypatch, statistic, period_s
):
    """An hour of a fast topic is not decoded whole."""
    monkeypatch.setattr(collector, "MOST_MESSAGES", 10_000)
    found = []
    for count in (8_000, 35_000):
        time_s = np.arange(count) * 0.002
        noise = 0.01 * np.random.default_rng(0).normal(size=count)
        values = np.cos(2.0 * np.pi / period_s * time_s + 0.3) + noise
        path = tmp_path / f"log{count}.csv"
        pd.DataFrame({"time": time_s, "a": values}).to_csv(path, index=False)
        found.append(signals_of(path)[f"signals./log/a.{statistic}"])
    of_sampling = 0.005 if statistic == "mean" else 0.001
    assert found[1] == pytest.approx(found[0], rel=0.02, abs=of_sampling)


def test_angle_that_turns_has_no_jump(tmp_path):
    yaw = np.mod(TIME_S + np.pi, 2.0 * np.pi) - np.pi
    found = signals_of(logged(tmp_path, yaw=yaw))
    assert found["signals./log/yaw.change"] == pytest.approx(0.05)


def test_counter_is_a_rate(tmp_path):
    found = signals_of(logged(tmp_path, count=np.arange(COUNT) * 3))
    assert found["signals./log/count.rate.mean"] == pytest.approx(60.0)
    assert "signals./log/count.mean" not in found


def test_a_counter_that_stands_still_has_a_rate_of_zero_and_a_level(tmp_path):
    found = signals_of(logged(tmp_path, count=np.full(COUNT, 7)))
    assert found["signals./log/count.rate.max"] == 0.0
    assert found["signals./log/count.mean"] == 7.0


def test_stuck_and_missing_numbers_are_told(tmp_path):
    noise = np.random.default_rng(0).normal(size=COUNT)
    stuck, missing = noise.copy(), noise.copy()
    stuck[50:150], missing[:50] = stuck[50], np.nan
    found = signals_of(logged(tmp_path, stuck=stuck, missing=missing))
    assert found["signals./log/stuck.held"] == pytest.approx(0.5, abs=0.01)
    assert found["signals./log/missing.missing"] == pytest.approx(0.25)


@pytest.mark.parametrize(("count", "held"), [(FEWEST_HELD - 1, np.nan), (FEWEST_HELD, 1.0)])
def test_few_messages_do_not_tell_whether_a_number_stands_still(bag_of, count, held):
    make = message_class("std_msgs/msg/Float64")
    found = signals_of(bag_of([(n * 1.0, "/level", make(1.0)) for n in range(count)]))
    assert found["signals./level/data.held"] == pytest.approx(held, nan_ok=True)


def test_nested_fields_quaternions_covariances_and_arrays_are_signals(bag_of, messages):
    poses = [messages.odometry(n * 0.1, 0.1 * n, 0.0, 0.01 * n, 0.1) for n in range(60)]
    scan = messages.scan(0.0, [1.0] * 300)
    bag = bag_of(
        [(n * 0.1, "/odom", pose) for n, pose in enumerate(poses)]
        + [(n * 0.1, "/scan", scan) for n in range(60)]
    )
    found = signals_of(bag)
    assert found["signals./odom/pose.pose.position.x.max"] == pytest.approx(5.9)
    assert found["signals./odom/pose.pose.orientation.yaw.max"] == pytest.approx(0.59)
    assert found["signals./odom/pose.pose.orientation.norm.mean"] == pytest.approx(1.0)
    assert "signals./odom/pose.covariance.trace.mean" in found
    assert found["signals./scan/ranges.mean.mean"] == pytest.approx(1.0)
    assert not [name for name in found if "stamp" in name or "frame_id" in name]


def test_each_joint_of_a_humanoid_is_a_signal_of_an_array_without_names(bag_of):
    layout = message_class("std_msgs/msg/MultiArrayLayout")([], 0)
    make = message_class("std_msgs/msg/Float64MultiArray")
    angles = np.arange(27.0)
    found = signals_of(bag_of([(n * 0.1, "/joints", make(layout, angles)) for n in range(60)]))
    levels = [value for name, value in found.items() if name.endswith(".mean")]
    assert set(angles) <= set(levels)


def test_each_motor_of_a_robot_counts_by_its_place_in_the_message(tmp_path):
    definition = f"made_msgs/Motor[3] motors\n{'=' * 80}\nMSG: made_msgs/Motor\nfloat64[2] q\n"
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/state", "made_msgs/msg/State", [], TypeDefinition(definition, ""))
        for n in range(60):
            bag.write("/state", n * 10**8, ENCAPSULATION + np.arange(n, n + 6.0).tobytes())
    found = signals_of(tmp_path / "bag")
    assert found["signals./state/motors[0].q[0].min"] == 0.0
    assert found["signals./state/motors[2].q[1].max"] == 64.0


def test_elements_with_a_name_and_no_number_have_no_signals(tmp_path):
    definition = f"made_msgs/Mode[1] modes\n{'=' * 80}\nMSG: made_msgs/Mode\nstring name\n"
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/modes", "made_msgs/msg/Modes", [], TypeDefinition(definition, ""))
        for n in range(60):
            bag.write("/modes", n * 10**8, ENCAPSULATION + b"\x04\0\0\0run\0")
    assert {name.rpartition(".")[0] for name in signals_of(tmp_path / "bag")} == {
        "signals./modes/period"
    }


@pytest.mark.slow
def test_numbers_count_from_when_they_come_however_long_the_recording(tmp_path):
    make = message_class("std_msgs/msg/Float64MultiArray")
    layout = message_class("std_msgs/msg/MultiArrayLayout")([], 0)
    lengths = [60] * 17_000 + [61] * 1000  # more than are decoded at once
    messages = [(n * 0.01, "/a", make(layout, np.full(k, 1.0 * k))) for n, k in enumerate(lengths)]
    write_bag(tmp_path / "bag", messages, "sqlite3")
    found = signals_of(tmp_path / "bag")
    assert found["signals./a/data[60].mean"] == 61.0
    assert found["signals./a/data[0].min"] == 60.0
    assert found["signals./a/data[0].max"] == 61.0


def test_each_joint_of_a_humanoid_with_fingers_counts_by_its_name(bag_of):
    make = message_class("sensor_msgs/msg/JointState")
    names, numbers = [f"joint_{n}" for n in range(43)], np.arange(43.0)
    found = signals_of(bag_of([
        (n * 0.1, "/joint_states", make(header(n * 0.1, ""), names, numbers, numbers, numbers))
        for n in range(60)
    ]))  # fmt: skip
    for field in ("position", "velocity", "effort"):
        assert found[f"signals./joint_states/{field}[joint_42].mean"] == 42.0


def test_joints_of_arm_and_gripper_on_one_topic_count_by_their_names(bag_of):
    make, none = message_class("sensor_msgs/msg/JointState"), np.zeros(0)
    parts = [(["pan", "lift"], [1.0, 2.0]), (["finger"], [3.0]), (["lift", "pan"], [2.0, 1.0])]
    found = signals_of(bag_of([
        (n * 0.1, "/joint_states", make(header(n * 0.1, ""), names, np.array(at), none, none))
        for n in range(60) for names, at in [parts[n % 3]]
    ]))  # fmt: skip
    for name, at in (("pan", 1.0), ("lift", 2.0), ("finger", 3.0)):
        assert found[f"signals./joint_states/position[{name}].mean"] == at
        assert found[f"signals./joint_states/position[{name}].std"] == 0.0


def test_each_status_of_diagnostics_counts_by_its_name_whoever_reports_it(bag_of):
    make = message_class("diagnostic_msgs/msg/DiagnosticArray")
    status = message_class("diagnostic_msgs/msg/DiagnosticStatus")
    reports = [[("base: motor/1", 2), ("base: cpu", 0)], [("wifi", 1)]]  # of two nodes
    found = signals_of(bag_of([
        (n * 0.5, "/diagnostics", make(header(n * 0.5, ""), [
            status(level, name, "", "", []) for name, level in reports[n % 2]
        ])) for n in range(60)
    ]))  # fmt: skip
    for name, level in (("base: motor_1", 2.0), ("base: cpu", 0.0), ("wifi", 1.0)):
        assert found[f"signals./diagnostics/status.{name}.level.mean"] == level
        assert found[f"signals./diagnostics/status.{name}.level.std"] == 0.0


def test_numbers_that_diagnostics_write_as_texts_count_by_part_and_key(bag_of):
    make = message_class("diagnostic_msgs/msg/DiagnosticArray")
    status = message_class("diagnostic_msgs/msg/DiagnosticStatus")
    pair = message_class("diagnostic_msgs/msg/KeyValue")
    texts = {"Voltage (V)": "-24.5", "Load": "98 %", "core/0": " 4.5e1DegC", "Serial": "12-B",
             "Version": "1.2.3", "Enabled": "True", "Address": "0x1F", "Empty": "",
             "\x1b[31mred\n": "9" * 5000}  # fmt: skip
    found = signals_of(bag_of([
        (n * 0.5, "/diagnostics", make(header(n * 0.5, ""), [
            status(0, "base", "", "", [pair(key, text) for key, text in texts.items()]),
            status(0, "arm", "", "", [pair("Voltage (V)", f"{n}")] if n % 2 else []),
        ])) for n in range(60)
    ]))  # fmt: skip
    means = {
        name.removeprefix("signals./diagnostics/status.").removesuffix(".mean"): value
        for name, value in found.items() if name.endswith(".mean")
    }  # fmt: skip
    keys = {key.replace("/", "_") for key in texts}
    written = {"base.Voltage (V)": -24.5, "base.Load": 98.0, "base.core_0": 45.0}
    written |= {"arm.Voltage (V)": 30.0}
    assert written == {name: n for name, n in means.items() if name.partition(".")[2] in keys}
    assert all(name.isprintable() for name in found)


def test_links_that_pass_the_pole_on_either_side_have_the_same_signals(bag_of):
    angles = np.linspace(1.2, 1.9, COUNT)
    found = signals_of(bag_of([
        (time_s, "/tf", link(time_s, child, Rotation.from_euler("yz", (angle, side))))
        for child, side in (("left", -0.001), ("right", 0.001))
        for time_s, angle in zip(TIME_S, angles, strict=True)
    ]))  # fmt: skip
    left, right = (
        {name.partition(".rotation.")[2]: value for name, value in found.items() if child in name}
        for child in ("left", "right")
    )
    assert left == pytest.approx(right, abs=0.01)
    assert left["z_axis.x.mean"] > 0.9
    assert max(value for name, value in left.items() if name.endswith(".change")) < 0.01


def link(time_s, child, turn):
    """Return the transform of a link that has turned."""
    message = transform(time_s, "arm", child, 0j, 0.0)
    rotation = message_class("geometry_msgs/msg/Quaternion")(*turn.as_quat())
    message.transforms[0].transform.rotation = rotation
    return message


def test_robot_without_features_of_its_own_has_hundreds_of_signals(tmp_path):
    rng = np.random.default_rng(0)
    columns = {
        f"motor.{n}.{of}": rng.normal(size=COUNT) for n in range(6) for of in ("i", "u", "t")
    }
    assert len(signals_of(logged(tmp_path, **columns))) >= 120


@pytest.mark.parametrize("columns", [120, MOST_SIGNALS, MOST_SIGNALS + 7])
def test_each_column_of_a_wide_table_counts_or_a_note_says_so(tmp_path, columns):
    table = {"time": np.arange(9.0), **{f"f{n}": np.zeros(9) for n in range(columns)}}
    pd.DataFrame(table).to_csv(tmp_path / "log.csv")
    with open_run(tmp_path / "log.csv") as run:
        found = features.extract(run, MANAGER)
    counted = {column for column in signal_columns(found.run) if column.endswith(".mean")}
    assert len(counted) == min(columns, MOST_SIGNALS) + 1  # the time between messages
    cut = [note for note in found.notes if note.startswith(CUT)]
    assert bool(cut) == (columns > MOST_SIGNALS)


def test_of_too_many_signals_those_of_topics_with_many_messages_count(tmp_path):
    fields = {f"f{n}": np.arange(60.0) for n in range(MOST_SIGNALS // 2)}
    for topic in "abc":
        pd.DataFrame({"time": np.arange(60.0), **fields}).to_csv(tmp_path / f"{topic}.csv")
    fast = {"time": np.arange(600) * 0.1, "rate": np.zeros(600)}
    pd.DataFrame(fast).to_csv(tmp_path / "z.csv")
    with open_run(tmp_path) as run:
        found = features.extract(run, MANAGER)
    assert "signals./z/rate.mean" in found.run
    (note,) = [note for note in found.notes if note.startswith(CUT)]
    assert "/b" in note
    assert "/c" in note
    assert "/a" not in note
