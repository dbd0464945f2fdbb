"""A watch receives, counts and records the messages of a domain, and publishes nothing."""

import threading
import time
from collections import Counter
from dataclasses import replace

import pytest

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.disturbances import Disturbances
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.graph_files import vertex_id
from oracle_pipeline.bags.types import message_class, serialize, typestore
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.live.domain import Domain
from oracle_pipeline.live.events import GraphTaken, MessageReceived, Note
from oracle_pipeline.live.watch import Watch
from oracle_pipeline.opened_run import open_run
from sim.middleware.qos import CLOCK, SENSOR_DATA
from tests.oracle_pipeline.live.robots import STRING, TEXT, Robot

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
_Clock = message_class(CLOCK_TYPE)
_Time = message_class("builtin_interfaces/msg/Time")


def tick(seconds):
    whole, rest = divmod(round(seconds * 1e9), 10**9)
    return serialize(_Clock(_Time(whole, rest)), CLOCK_TYPE)


class Speaker(threading.Thread):
    """A robot that publishes in a thread; its simulated clock runs faster than real time."""

    def __init__(self, domain, *, speed=10.0):
        super().__init__(daemon=True)
        self.robot = Robot(domain).node("talker", publishes=["/words"]).announce()
        self.clock = dds.RawWriter(self.robot.participant, "rt/clock", CLOCK_TYPE, CLOCK)
        self.speed, self.sent, self.ended = speed, 0, False

    def run(self):
        step = 0
        while not self.ended:
            self.clock.write(tick(100.0 + step * 0.02 * self.speed))
            self.robot.writers["talker", "/words"].write(TEXT)
            self.sent += 1
            step += 1
            time.sleep(0.02)


@pytest.fixture
def speaker(domain):
    speaker = Speaker(domain)
    yield speaker
    speaker.ended = True
    if speaker.ident:
        speaker.join()


def watched(watch, until):
    """Return the events of a watch until a condition on them holds."""
    events = []
    for event in watch:
        events.append(event)
        if until(events):
            watch.stop()
    return events


def graphs(events):
    return [event for event in events if isinstance(event, GraphTaken)]


@pytest.mark.slow
def test_messages_and_graphs_are_recorded_in_simulated_time(domain, speaker, tmp_path):
    speaker.start()
    with Watch(Domain(domain), folder=tmp_path, name="today") as watch:
        events = watched(watch, lambda so_far: len(graphs(so_far)) == 2)
    assert watch.recordings == [tmp_path / "today"]
    received = Counter(event.topic for event in events if isinstance(event, MessageReceived))
    with open_run(tmp_path / "today", strict=True) as run:
        assert {name: topic.count for name, topic in run.bag.topics.items()} == received
        words = list(run.bag.messages(["/words"]))
        assert {message.data for message in words} == {TEXT}
        assert [interval.start_s for interval in run.intervals[:2]] == [0.0, 10.0]
        assert 100.0 < run.bag.start_ns / 1e9 < 200.0
        edge = vertex_id("node", "/talker"), vertex_id("topic", "/words")
        counted = [interval.graph.edges[edge]["messages"] for interval in run.intervals]
    assert counted == [event.graph.edges[edge]["messages"] for event in graphs(events)]
    assert sum(counted) <= received["/words"]
    assert sum(counted) >= 0.9 * received["/words"]
    assert not list(tmp_path.glob(".*"))


@pytest.mark.slow
def test_a_recording_ends_after_a_piece_and_the_next_begins(domain, speaker, tmp_path):
    speaker.start()
    with Watch(Domain(domain), folder=tmp_path, name="today", piece_s=10.0) as watch:
        events = watched(watch, lambda _: len(watch.recordings) == 4)
    kept = []
    for path in watch.recordings:
        with open_run(path, strict=True) as run:
            kept += [message.stamp_ns for message in run.bag.messages()]
            if path != watch.recordings[-1]:
                assert 9.0 < run.duration_s < 10.0
                assert [interval.start_s for interval in run.intervals] == [0.0]
    assert kept == [event.stamp_ns for event in events if isinstance(event, MessageReceived)]


@pytest.mark.slow
def test_a_watch_has_no_writer_on_the_domain(domain, speaker, tmp_path):
    speaker.start()
    own = dds.join(domain)
    builtin = dds.BuiltinReaders(own)
    with Watch(Domain(domain), folder=tmp_path) as watch:
        watched(watch, lambda so_far: len(so_far) > 20)
        writers = {each.topic for each in builtin.publications() if each.alive}
        readers = {each.topic for each in builtin.subscriptions() if each.alive}
    assert writers == {"rt/words", "rt/clock", "ros_discovery_info"}  # all are the robot's
    assert {"rt/words", "rt/clock"} <= readers  # it was there


class Flood(threading.Thread):
    """A robot that numbers its messages, and sends 10,000 of them at once after the first ones."""

    def __init__(self, domain):
        super().__init__(daemon=True)
        self.robot = Robot(domain).node("talker", publishes=["/words"]).announce()
        self.heard, self.ended, self.number = threading.Event(), False, 0

    def run(self):
        self.until(self.heard.is_set)
        self.send(10_000)  # more than any reader can take while they come
        self.until(lambda: self.ended)

    def until(self, is_over):
        while not is_over():
            self.send(1)
            time.sleep(0.05)

    def send(self, messages):
        numbers = range(self.number, self.number + messages)
        texts = [serialize(message_class(STRING)(str(number)), STRING) for number in numbers]
        for text in texts:
            self.robot.writers["talker", "/words"].write(text)
        self.number += messages


@pytest.mark.slow
def test_every_message_is_recorded_or_counted_as_lost_and_timing_is_missing_then(domain, tmp_path):
    flood, numbers, notes = Flood(domain), [], []
    flood.start()
    with Watch(Domain(domain, 20_000), folder=tmp_path, name="today") as watch:
        for event in watch:
            if isinstance(event, MessageReceived):
                numbers.append(int(typestore().deserialize_cdr(event.data, STRING).data))
                if len(numbers) == 20:
                    flood.heard.set()
                if numbers[-1] - numbers[0] > 10_100:
                    watch.stop()
            notes += [event.text] if isinstance(event, Note) else []
    flood.ended = True
    flood.join()
    sent = numbers[-1] - numbers[0] + 1
    lost = watch.losses.lost["/words"]
    assert lost > 1000
    assert len(numbers) == watch.received == sent - lost
    assert sum(int(note.split()[0]) for note in notes) == lost
    with open_run(tmp_path / "today") as run:
        assert run.bag.topics["/words"].count == len(numbers)
        assert run.disturbances.lost == {"/words": lost}
        assert run.disturbances.spans
        assert f"/words {lost}" in run.bag.losses[0]
        manager = build_manager(None)
        told = extract(run, manager)
        untold = extract(replace(run, disturbances=Disturbances()), manager)
    features = manager.features()
    timing = {column for column, feature in features.items() if feature.timing}
    of_run, of_windows = (
        {c for c in features if c in lossy and (lossy[c].isna() & whole[c].notna()).any()}
        for lossy, whole in ((told.run, untold.run), (told.windows, untold.windows))
    )
    assert of_run == {column for column in timing if untold.run[column].notna().any()}
    assert {"generic.message_rate"} <= of_windows <= timing
    with pytest.raises(BagError, match="came too fast"):
        open_run(tmp_path / "today", strict=True)


@pytest.mark.slow
def test_a_topic_of_an_unknown_type_is_reported_once_and_affects_no_other(domain, speaker):
    other = Robot(domain)
    stranger = dds.topic.Topic(other.participant, "rt/odd", _unknown_type())
    writer = dds.pub.DataWriter(other.participant, stranger)
    speaker.start()
    with Watch(Domain(domain)) as watch:
        events = watched(
            watch, lambda so_far: sum(isinstance(event, MessageReceived) for event in so_far) > 10
        )
    (note,) = [event.text for event in events if isinstance(event, Note)]
    assert "/odd" in note
    assert "odd_msgs/msg/Odd" in note
    assert writer


def _unknown_type():
    return dds.make_idl_struct("Odd_", "odd_msgs::msg::dds_::Odd_", {"number": dds.idl.int32})


@pytest.mark.slow
def test_a_later_publisher_with_incompatible_qos_is_reported(domain, speaker):
    speaker.start()
    with Watch(Domain(domain)) as watch:
        late = []

        def until(events):
            if len(events) > 20 and not late:
                late.append(
                    Robot(domain).node("late", publishes=["/words"], qos=SENSOR_DATA).announce()
                )
            return any(isinstance(event, Note) for event in events)

        events = watched(watch, until)
    (note,) = [event.text for event in events if isinstance(event, Note)]
    assert "/words" in note
