"""However `oracle watch` ends, its recording is there up to a second before."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from oracle_pipeline.bags import dds
from oracle_pipeline.bags.run_directory import is_complete_recording
from oracle_pipeline.live.domain import Domain
from oracle_pipeline.live.events import MessageReceived, Note
from oracle_pipeline.live.watch import Watch
from oracle_pipeline.opened_run import open_run
from sim.middleware.qos import CLOCK
from tests.oracle_pipeline.live.robots import TEXT, Robot
from tests.oracle_pipeline.live.test_watch import CLOCK_TYPE, tick

pytestmark = pytest.mark.slow(4)

ORACLE = Path(sys.executable).with_name("oracle")
WORDS = "/words"


class Speaker(threading.Thread):
    """A robot without a clock that publishes slowly, and knows when it sent what."""

    def __init__(self, domain, period_s=0.5):
        super().__init__(daemon=True)
        self.robot = Robot(domain).node("talker", publishes=[WORDS]).announce()
        self.period_s, self.sent_s, self.ended = period_s, [], False

    def run(self):
        while not self.ended:
            self.robot.writers["talker", WORDS].write(TEXT)
            self.sent_s.append(time.time())
            time.sleep(self.period_s)


@pytest.fixture
def speaker(domain):
    speaker = Speaker(domain)
    speaker.start()
    yield speaker
    speaker.ended = True
    speaker.join()


def started(domain, folder, *options):
    command = [ORACLE, "watch", "--domain", str(domain), "--out", folder, *options]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=dict(os.environ))


def count(path):
    with open_run(path) as run:
        return run.bag.topics[WORDS].count


def recording(folder, eventually, least=1):
    """Wait until the one recording in a folder holds some messages, and return it."""

    def found():
        try:
            (path,) = folder.glob("*")
            return path if count(path) >= least else None
        except Exception:
            return None

    return eventually(found)


def test_a_killed_watch_loses_a_second_of_a_slow_topic_and_the_next_one_finishes_it(
    domain, speaker, eventually, tmp_path
):
    watch = started(domain, tmp_path)
    path = recording(tmp_path, eventually, 4)
    time.sleep(3.0)
    watch.kill()
    watch.wait()
    killed_s = time.time()
    with open_run(path) as run:
        kept = [message.stamp_ns / 1e9 for message in run.bag.messages([WORDS])]
    sent = [s for s in speaker.sent_s if kept[0] - 0.3 < s < killed_s - 2.0]
    assert len(kept) >= len(sent) >= 6
    assert not is_complete_recording(path)
    again = started(domain, tmp_path, "--duration", "1")
    _, said = again.communicate(timeout=300)
    assert f"{path} was not completed. {len(kept)} messages are kept." in said
    assert is_complete_recording(path)
    with open_run(path, strict=True) as run:
        assert run.bag.topics[WORDS].count == len(kept)
    with AnyReader([path / "bag"]) as by_another:
        assert len([1 for c, *_ in by_another.messages() if c.topic == WORDS]) == len(kept)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_recording_properly(domain, speaker, eventually, tmp_path, number):
    watch = started(domain, tmp_path)
    path = recording(tmp_path, eventually)
    watch.send_signal(number)
    _, said = watch.communicate(timeout=300)
    assert watch.returncode == 0, said
    assert is_complete_recording(path)
    assert said.count("Recording:") == 1
    with open_run(path, strict=True) as run:
        assert run.bag.topics[WORDS].count


def test_an_error_in_the_program_keeps_the_recording(domain, speaker, tmp_path):
    with (
        contextlib.suppress(ZeroDivisionError),
        Watch(Domain(domain), folder=tmp_path, name="today") as w,
    ):
        for number, _ in enumerate(event for event in w if isinstance(event, MessageReceived)):
            1 / (3 - number)
    assert is_complete_recording(tmp_path / "today")
    assert count(tmp_path / "today") >= 4


class Clock(threading.Thread):
    """Ticks of /clock: 0 for two seconds, then the time since 1970."""

    def __init__(self, robot, jumps_s):
        super().__init__(daemon=True)
        self.writer = dds.RawWriter(robot.participant, "rt/clock", CLOCK_TYPE, CLOCK)
        self.jumps_s, self.ended = jumps_s, False

    def run(self):
        begin = time.monotonic()
        while not self.ended:
            now_s = time.monotonic() - begin
            self.writer.write(tick(now_s + (1.7e9 if now_s > self.jumps_s else 0.0)))
            time.sleep(0.05)


def test_a_clock_that_jumps_by_decades_begins_another_recording_and_nothing_else(
    domain, speaker, tmp_path
):
    clock = Clock(speaker.robot, jumps_s=8.0)
    clock.start()
    begin = time.monotonic()
    with Watch(Domain(domain), folder=tmp_path, name="today") as watch:
        notes = []
        for event in watch:
            notes += [event.text] if isinstance(event, Note) else []
            if time.monotonic() - begin > 16.0 and not watch._stopped:
                watch.stop()
                stopped = time.monotonic()
    assert time.monotonic() - stopped < 2.0
    clock.ended = True
    assert [note for note in notes if "Another recording begins" in note]
    assert [path.name for path in watch.recordings] == ["today", "today_2"]
    for path in watch.recordings:
        with open_run(path, strict=True) as run:
            assert 0.0 < run.duration_s < 25.0
            assert len(run.intervals) <= 3
            assert run.bag.topics[WORDS].count > 5


def test_a_silent_clock_gives_way_to_wall_time(domain, speaker, tmp_path):
    writer = dds.RawWriter(speaker.robot.participant, "rt/clock", CLOCK_TYPE, CLOCK)
    begin_s = time.time()
    with Watch(Domain(domain), folder=tmp_path, name="today") as watch:
        notes = []
        for event in watch:
            notes += [event.text] if isinstance(event, Note) else []
            if watch.received > 12:
                watch.stop()
    assert ["wall time" in note for note in notes] == [True]
    with open_run(tmp_path / "today", strict=True) as run:
        assert run.bag.topics[WORDS].count >= 12
        assert run.bag.start_ns / 1e9 - begin_s < 5.0  # messages from before the note are in it
    assert writer
