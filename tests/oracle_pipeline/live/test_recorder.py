"""A recording is readable up to its last flush, however its writer ends."""

import json
import shutil
import subprocess
import sys

import pytest
from mcap.reader import make_reader

from oracle_pipeline.bags.arrivals import arrivals
from oracle_pipeline.bags.run_directory import is_complete_recording
from oracle_pipeline.live.recorder import Recorder
from oracle_pipeline.live.recovery import recover
from oracle_pipeline.live.split_bag import Split
from oracle_pipeline.opened_run import open_run
from sim.middleware.qos import DEFAULT
from tests.oracle_pipeline.features.conftest import ros_graph
from tests.oracle_pipeline.live.robots import STRING, TEXT

SECOND_NS = 10**9
WORDS = "/words"


def recorder(path, split=Split(), keep_free_bytes=0):  # noqa: B008 -- immutable
    made = Recorder(path, {"domain": 7}, split, keep_free_bytes)
    made.add_topic(WORDS, STRING, [DEFAULT])
    return made


def write(made, seconds, per_second=10):
    """Record messages, with a flush at the end of each second."""
    for second in seconds:
        for number in range(per_second):
            made.write(WORDS, SECOND_NS * second + number, TEXT)
        made.flush()


def stamps(path):
    with open_run(path) as run:
        return [message.stamp_ns for message in run.bag.messages()]


def expected(seconds, per_second=10):
    return [SECOND_NS * s + n for s in seconds for n in range(per_second)]


def test_a_recording_in_progress_is_readable_and_not_taken_for_complete(tmp_path):
    made = recorder(tmp_path / "today")
    write(made, range(3))
    made.write_graph(0, ros_graph())
    assert stamps(tmp_path / "today") == expected(range(3))
    assert not is_complete_recording(tmp_path / "today")
    assert not arrivals(tmp_path).found[0].is_finished()
    assert not list(recover(tmp_path))  # its writer lives
    made.close()
    assert is_complete_recording(tmp_path / "today")
    assert arrivals(tmp_path).found[0].is_finished()
    with open_run(tmp_path / "today", strict=True) as run:
        assert len(run.intervals) == 1


@pytest.mark.parametrize("cut", [0, 1, 40, 400])
def test_what_a_killed_watch_left_is_finished_in_place(tmp_path, cut):
    made = recorder(tmp_path / "live")
    made.add_topic("/silent", STRING, [DEFAULT])
    write(made, range(5))
    made.write_graph(0, ros_graph())
    for number in range(10):
        made.write(WORDS, 5 * SECOND_NS + number, TEXT)
    made._bag._store()
    made._bag._file.storage.close_chunk()
    made._bag._file.storage.bio.flush()  # as far as it came in the second of the kill
    killed = tmp_path / "left" / "killed"
    shutil.copytree(tmp_path / "live", killed)
    made.close()
    (file,) = (killed / "bag").glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size - cut])
    assert stamps(killed)[:50] == expected(range(5))
    with open_run(killed) as run:
        assert run.bag.topics.keys() == {WORDS, "/silent"}  # or a contract lacks the topic
    (recovered,) = recover(tmp_path / "left")
    assert not recovered.fault
    assert recovered.messages == len(stamps(killed)) in (50, 60)
    assert recovered.messages == 60 if cut == 0 else True
    with open_run(killed, strict=True) as run:
        assert len(run.intervals) == 1
        assert run.bag.topics[WORDS].qos == (DEFAULT,)
    summary = json.loads((killed / "recording.json").read_text())
    assert summary["complete"]
    assert summary["domain"] == 7
    assert not list(recover(tmp_path / "left"))  # once is enough
    with file.open("rb") as source:  # another reader needs the summary
        reader = make_reader(source, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == recovered.messages
        assert len(list(reader.iter_messages())) == recovered.messages


def test_a_recording_that_was_killed_at_once_is_reported_once(tmp_path):
    made = recorder(tmp_path / "live")
    shutil.copytree(tmp_path / "live", tmp_path / "left" / "killed")
    made.close()
    (recovered,) = recover(tmp_path / "left")
    assert recovered.messages == 0
    assert not list(recover(tmp_path / "left"))


@pytest.mark.parametrize("split", [Split(size_bytes=1000), Split(seconds=2.0)])
def test_a_split_recording_is_one_recording(tmp_path, split):
    made = recorder(tmp_path / "today", split)
    write(made, range(10))
    made.close()
    assert len(list((tmp_path / "today" / "bag").glob("*.mcap"))) >= 3
    assert stamps(tmp_path / "today") == expected(range(10))
    with open_run(tmp_path / "today", strict=True) as run:
        assert run.bag.topics[WORDS].count == 100


def test_a_split_recording_that_was_killed_is_finished(tmp_path):
    made = recorder(tmp_path / "live", Split(seconds=2.0))
    write(made, range(9))
    shutil.copytree(tmp_path / "live", tmp_path / "left" / "killed")
    made.close()
    (recovered,) = recover(tmp_path / "left")
    assert recovered.messages == 90
    with open_run(tmp_path / "left" / "killed", strict=True) as run:
        assert run.bag.topics[WORDS].count == 90


def test_recording_ends_before_the_disk_is_full(tmp_path):
    made = recorder(tmp_path / "today", keep_free_bytes=2**60)
    write(made, range(3))
    assert "MiB are free" in made.ended
    made.close()
    assert stamps(tmp_path / "today") == expected(range(1))
    assert (
        "MiB are free" in json.loads((tmp_path / "today" / "recording.json").read_text())["ended"]
    )


FULL = """
import resource, sys
from pathlib import Path
from tests.oracle_pipeline.live.test_recorder import recorder, write
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
made = recorder(Path(sys.argv[1]))
write(made, range(100), 500)
print(made.ended)
made.close()
"""


def test_on_a_full_disk_everything_flushed_is_kept(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL, tmp_path / "today"], capture_output=True, text=True, check=True
    )
    assert "File too large" in done.stdout
    kept = stamps(tmp_path / "today")
    assert len(kept) >= 500
    assert kept == expected(range(len(kept) // 500), 500)
    assert is_complete_recording(tmp_path / "today")
