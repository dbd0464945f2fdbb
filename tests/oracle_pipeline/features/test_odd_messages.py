"""Unusual messages of real and broken robots lose only the affected values, with a reason."""

import logging
import tracemalloc
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.types import message_class, serialize
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.features import build_manager, measure
from oracle_pipeline.features.statistics.times import MOST_TIMES, even_spans, even_times
from oracle_pipeline.opened_run import open_run
from tests.oracle_pipeline.features.conftest import START_NS, drive, pose_message, write_bag

MANAGER = build_manager()
SENSORS = ("/odom", "/scan", "/scan_fakeobject")
MOST_BYTES = 100e6  # that the features of these recordings may take


def altered(*topics, **alterations):
    """Return the drive with altered messages on some topics: each field by a function of time."""
    recorded = drive()
    for t, topic, message in recorded:
        if topic in topics:
            for path, value in alterations.items():
                *owners, name = path.split("__")
                owner = message
                for each in owners:
                    owner = getattr(owner, each)
                setattr(owner, name, value(t))
    return recorded


def stamp_of(early_s):
    """Return stamps of a driver that does not know the time for five seconds."""
    time = message_class("builtin_interfaces/msg/Time")
    return lambda t: time(early_s if t < 5.0 else 1_700_000_000 + int(t), int(t % 1 * 1e9))


def quaternion(*values):
    return lambda _: message_class("geometry_msgs/msg/Quaternion")(*values)


def grid(width, height, cells, resolution):
    info = message_class("nav_msgs/msg/MapMetaData")(
        message_class("builtin_interfaces/msg/Time")(0, 0), resolution, width, height,
        pose_message(0, 0, 0),
    )  # fmt: skip
    header = message_class("std_msgs/msg/Header")(info.map_load_time, "map")
    message = message_class("nav_msgs/msg/OccupancyGrid")(header, info, np.zeros(cells, np.int8))
    return [(0.0, "/map", message), *drive()]


def ranges(of):
    return altered("/scan", ranges=lambda t: np.asarray(of(t), dtype=np.float32))


POSITION = "pose__pose__position__x"
ODD = {
    "clock of a sensor set late": altered("/scan", header__stamp=stamp_of(0)),
    "clocks of all sensors set late": altered(*SENSORS, header__stamp=stamp_of(0)),
    "stamps of the year 2038": altered(*SENSORS, header__stamp=stamp_of(2**31 - 1)),
    "stamps before 1970": altered(*SENSORS, header__stamp=stamp_of(-(2**31))),
    "far away": altered("/odom", **{POSITION: lambda t: 2e3 * (t > 9)}),
    "coordinates of a map of the world": altered("/odom", **{POSITION: lambda t: 4e6 * (t > 9)}),
    "a position that overflows": altered("/odom", **{POSITION: lambda t: 1e300 * (t % 2 - 1)}),
    "no position": altered("/odom", **{POSITION: lambda _: np.nan}),
    "a position lost on the way": altered(
        "/odom", **{POSITION: lambda t: np.inf if t > 9 else 0.1 * t}
    ),
    "no orientation": altered("/odom", pose__pose__orientation=quaternion(0.0, 0.0, 0.0, 0.0)),
    "a huge orientation": altered("/odom", pose__pose__orientation=quaternion(1e200, 0.0, 0.0, 1)),
    "no frames": altered("/odom", header__frame_id=lambda _: "", child_frame_id=lambda _: ""),
    "no beams": ranges(lambda _: []),
    "one beam": ranges(lambda _: [1.0]),
    "any number of beams": ranges(lambda t: np.ones(int(t * 5) % 7)),
    "beams without a return": ranges(lambda _: [np.inf] * 12),
    "beams without a number": ranges(lambda _: [np.nan] * 12),
    "negative ranges": ranges(lambda _: [-1.0, -np.inf] * 6),
    "no angle between beams": altered("/scan", angle_increment=lambda _: 0.0),
    "a tiny angle between beams": altered("/scan", angle_increment=lambda _: 1e-30),
    "a turn from beam to beam": altered("/scan", angle_increment=lambda _: 7.0),
    "endless angles": altered("/scan", angle_min=lambda _: np.inf, angle_max=lambda _: np.nan),
    "all at once": [(1.0, topic, message) for _, topic, message in drive()],
    "a map without cells": grid(0, 0, 0, 0.05),
    "a map of cells without size": grid(10, 10, 100, 0.0),
}  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_odd_content_breaks_no_plugin_and_takes_little_memory(name, tmp_path, caplog):
    write_bag(tmp_path / "bag", ODD[name])
    tracemalloc.start()
    with open_run(tmp_path / "bag") as run, warnings.catch_warnings():
        warnings.simplefilter("error")
        measured = measure(run, MANAGER)
    assert tracemalloc.get_traced_memory()[1] < MOST_BYTES
    tracemalloc.stop()
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]
    (row,) = measured.run.rows()
    assert row["generic.message_rate"] > 0.0


def test_a_name_that_is_not_utf_8_is_a_name(tmp_path):
    with BagWriter(tmp_path / "named") as named, BagWriter(tmp_path / "renamed") as renamed:
        for seconds, topic, message in drive():
            data = serialize(message, message.__msgtype__)
            for bag, frame in ((named, b"base_scan"), (renamed, b"base_sc\xe4n")):
                bag.add_topic(topic, message.__msgtype__, [])
                at_ns = START_NS + round(seconds * 1e9)
                bag.write(topic, at_ns, data.replace(b"base_scan", frame))
    rows = []
    for name in ("named", "renamed"):
        with open_run(tmp_path / name) as run:
            (row,) = measure(run, MANAGER).run.rows()
        rows.append({n: v for n, v in row.items() if v == v and n != "run_id"})
    compressed = {n for n in rows[0] if rows[0][n] != rows[1].get(n)}  # sees bytes, not names
    assert compressed <= {"generic.compressibility_std", "generic.compressibility_mean"}


BROKEN = {
    "cut": lambda data: data[: len(data) // 2],
    "empty": lambda _: b"",
    "of another encoding": lambda data: b"\0\7\0\0" + data[4:],
    "too long": lambda data: data + bytes(40),
    "of endless sequences": lambda data: data[:56] + b"\xff" * (len(data) - 56),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_topic_of_broken_messages_is_reported_and_affects_no_other(name, tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for seconds, topic, message in drive():
            data = serialize(message, message.__msgtype__)
            bag.add_topic(topic, message.__msgtype__, [])
            bag.write(
                topic, START_NS + round(seconds * 1e9),
                BROKEN[name](data) if topic == "/scan" else data,
            )  # fmt: skip
    with open_run(tmp_path / "bag") as run:
        measured = measure(run, MANAGER)
    (note,) = measured.notes
    assert note.startswith("/scan: what needs it is missing: 136 of 136 messages are broken: ")
    (row,) = measured.run.rows()
    assert row["contextual.total_turning"] > 1.0  # of /odom


def test_a_recording_without_messages_is_reported(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/scan", "sensor_msgs/msg/LaserScan", [])
    with open_run(tmp_path / "bag") as run:
        assert measure(run, MANAGER).notes == ("It has no messages.",)


def test_a_clock_that_stood_still_is_told(tmp_path):
    write_bag(tmp_path / "bag", ODD["all at once"])
    with open_run(tmp_path / "bag") as run:
        (note,) = measure(run, MANAGER).notes
    assert "were recorded at the same time: the recorder's clock stood still" in note


@given(st.lists(st.floats(0.0, 1e3), min_size=2), st.floats(0.05, 1.0))
def test_even_times_are_those_of_a_range_where_there_are_few(stamps, step):
    times = even_times(min(stamps), max(stamps), step, np.array(stamps))
    assert (times == np.arange(min(stamps), max(stamps), step)).all()


def test_even_times_leave_long_pauses_out_and_no_span_crosses_one():
    stamps = np.concatenate([np.arange(0.0, 30.0, 0.1), 1.7e9 + np.arange(0.0, 30.0, 0.1)])
    begins, ends = even_spans(stamps[0], stamps[-1], 0.4, stamps)
    assert len(begins) == pytest.approx(150, abs=3)
    assert ends - begins == pytest.approx(0.4, abs=1e-6)


def test_too_many_even_times_are_refused():
    stamps = np.arange(0.0, 50.0 * MOST_TIMES, 50.0)
    with pytest.raises(BagError, match="MOST_TIMES"):
        even_times(0.0, stamps[-1], 0.1, stamps)
