"""A black box keeps the time around alarms, and nothing else."""

import json
import math
import shutil
from itertools import count

import pytest

from oracle_pipeline.bags import dds
from oracle_pipeline.live.black_box import BlackBox, Keep
from oracle_pipeline.live.domain import Domain
from oracle_pipeline.live.events import MessageReceived
from oracle_pipeline.live.recorder import Recorder
from oracle_pipeline.live.recovery import recover
from oracle_pipeline.live.split_bag import Message, Split
from oracle_pipeline.live.trigger_service import QOS, REPLY, REQUEST, TYPES
from oracle_pipeline.live.watch import Watch
from oracle_pipeline.opened_run import open_run
from sim.middleware.qos import DEFAULT, LATCHED
from tests.oracle_pipeline.features.conftest import ros_graph
from tests.oracle_pipeline.live.robots import STRING, TEXT
from tests.oracle_pipeline.live.test_watch import speaker, watched

SECOND_NS = 10**9
MAP, WORDS = "/map", "/words"
__all__ = ["speaker"]


class Robot:
    """A recorder that gets a message a second, and the end of each interval of 10 s."""

    def __init__(self, folder, keep):
        self.folder, self.box, self.now_s = folder, BlackBox(keep), 0
        self.latched = [Message(MAP, 0, TEXT)]
        self.recorder = self.made(0)
        self.recorder.write(*self.latched[0])

    def made(self, start_s):
        facts = {"start_ns": start_s * SECOND_NS}
        made = Recorder(self.folder / str(start_s), facts, Split(), 0, start_s)
        made.add_topic(WORDS, STRING, [DEFAULT])
        made.add_topic(MAP, STRING, [LATCHED])
        return made

    def drive(self, until_s):
        for now_s in range(self.now_s + 1, until_s + 1):
            self.now_s = now_s
            self.recorder.write(WORDS, self.now_s * SECOND_NS - 1, TEXT)
            self.recorder.flush()
            if self.now_s % 10 == 0:
                self.recorder.write_graph(self.now_s - 10, ros_graph())
                if self.box.is_complete(self.recorder, self.now_s, self.latched):
                    self.box.take(self.recorder)
                    self.recorder = self.made(self.now_s)


def seconds_of(path):
    """Return when the words of a recording came, and check what else it has."""
    with open_run(path, strict=True) as run:
        seconds = [round(m.stamp_ns / SECOND_NS) for m in run.bag.messages([WORDS])]
        (of_map,) = run.bag.messages([MAP])
        assert of_map.stamp_ns <= seconds[0] * SECOND_NS
        starts = [interval.start_s for interval in run.intervals]
        assert starts == [10.0 * n for n in range(len(seconds) // 10)]
        assert run.bag.topics[WORDS].count == len(seconds)
    return seconds


def test_the_time_before_and_after_an_alarm_is_one_recording(tmp_path):
    robot = Robot(tmp_path, Keep(20.0, 10.0))
    robot.drive(95)
    robot.box.alarm(95.0, {"trigger": "a test"})
    robot.drive(200)
    assert not robot.box.take(robot.recorder)
    (kept,) = robot.box.kept
    assert list(tmp_path.iterdir()) == [kept]
    assert seconds_of(kept) == list(range(71, 111))
    summary = json.loads((kept / "recording.json").read_text())
    assert summary["start_ns"] == 70 * SECOND_NS
    assert summary["messages"] == {WORDS: 40, MAP: 1}
    assert summary["alarms"] == [{"at_s": 25.0, "trigger": "a test"}]


def test_alarms_that_follow_each_other_are_in_one_recording(tmp_path):
    robot = Robot(tmp_path, Keep(10.0, 10.0))
    for alarm_s in (35, 48):
        robot.drive(alarm_s)
        robot.box.alarm(alarm_s, {"trigger": "a test"})
    assert robot.box.take(robot.recorder)
    assert seconds_of(robot.box.kept[0]) == list(range(21, 49))


def test_a_killed_black_box_leaves_the_time_before(tmp_path):
    robot = Robot(tmp_path / "live", Keep(20.0, 10.0))
    robot.drive(95)
    shutil.copytree(robot.recorder.path, tmp_path / "left" / "killed")
    robot.box.take(robot.recorder)
    (recovered,) = recover(tmp_path / "left")
    assert not recovered.fault
    assert seconds_of(tmp_path / "left" / "killed") == list(range(71, 96))


@pytest.mark.parametrize(("share", "left"), [(0.1, 0), (0.5, 1), (1.0, 3)])
def test_all_that_is_kept_has_a_limit_and_the_newest_stays(tmp_path, share, left):
    kept_at(tmp_path / "all", math.inf)
    size = sum(path.stat().st_size for path in (tmp_path / "all").rglob("*") if path.is_file())
    kept = kept_at(tmp_path / "some", share * size)
    assert set((tmp_path / "some").iterdir()) == set(kept)
    assert [path.name for path in kept] == ["0", "40", "100"][3 - left :]


def kept_at(folder, most_bytes):
    robot = Robot(folder, Keep(10.0, 10.0, most_bytes))
    for alarm_s in (25, 85, 145):
        robot.drive(alarm_s)
        robot.box.alarm(alarm_s, {"trigger": "a test"})
        robot.drive(alarm_s + 30)
    robot.box.take(robot.recorder)
    return robot.box.kept


@pytest.mark.slow
def test_a_watch_keeps_the_time_around_a_message_on_a_topic(domain, speaker, tmp_path):
    robot = speaker.robot.node("talker", publishes=["/stop"])
    robot.node("mapper", publishes=[MAP], qos=LATCHED).announce()
    robot.writers["mapper", MAP].write(TEXT)
    speaker.start()
    keep = Keep(20.0, 10.0, topics=frozenset({"/stop"}))
    with Watch(Domain(domain), folder=tmp_path, name="today", keep=keep) as watch:

        def until(so_far):
            passed_s = (so_far[-1].stamp_ns - so_far[0].stamp_ns) / SECOND_NS
            if passed_s > 70.0 and not stopped:
                stopped.append(robot.writers["talker", "/stop"].write(TEXT))
            return passed_s > 120.0

        stopped = []
        messages = watched(watch, lambda so_far: until(_messages(so_far)))
    (path,) = watch.recordings
    assert list(tmp_path.iterdir()) == [path]
    received = _messages(messages)
    (stop_ns,) = [event.stamp_ns for event in received if event.topic == "/stop"]
    with open_run(path, strict=True) as run:
        kept = list(run.bag.messages())
        begin_ns, end_ns = kept[0].stamp_ns, kept[-1].stamp_ns
        assert {m.topic for m in kept if m.stamp_ns == begin_ns} >= {MAP}
        assert begin_ns <= stop_ns - 20 * SECOND_NS
        assert stop_ns + 10 * SECOND_NS <= end_ns < stop_ns + 21 * SECOND_NS
        assert [m.stamp_ns for m in kept if m.topic != MAP] == [
            event.stamp_ns for event in received if begin_ns <= event.stamp_ns <= end_ns
        ]  # fmt: skip


@pytest.mark.slow
def test_a_call_of_the_service_is_counted_and_gets_the_answer_with_its_number(domain, eventually):
    source, robot = Domain(domain, service="/oracle/keep"), dds.join(domain)
    requests, replies = (kind(robot, name, msgtype, QOS, TYPES) for kind, name, msgtype in (
        (dds.RawWriter, "rq/oracle/keepRequest", REQUEST),
        (dds.RawReader, "rr/oracle/keepReply", REPLY),
    ))  # fmt: skip
    numbers = count(1)

    def answered():
        call = TYPES.types[REQUEST](7, next(numbers), 0)
        requests.write(bytes(TYPES.serialize_cdr(call, REQUEST)))
        return source.calls() and replies.take()

    answer = TYPES.deserialize_cdr(eventually(answered)[0].data, REPLY)
    assert (answer.client, answer.success) == (7, True)
    assert 0 < answer.number < next(numbers)
    source.close()


def _messages(events):
    return [event for event in events if isinstance(event, MessageReceived)]
