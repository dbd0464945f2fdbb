"""Invalid recordings: each command names them in one line, and continues with the others."""

import json
import os
import sqlite3
import struct

import pytest
from click.testing import CliRunner

from oracle_pipeline.cli import main
from sim.commands.main import main as sim_main
from tests.oracle_pipeline.bags.makers import MAGIC
from tests.oracle_pipeline.features.conftest import drive, write_bag
from tests.oracle_pipeline.scoring.test_score_command import spinning

pytestmark = pytest.mark.slow


def cut(path, share):
    write_bag(path, drive(5))
    (file,) = path.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * share)])


def huge_chunk(path):
    sizes = struct.pack("<QQQI", 0, 1, 2**50, 0) + struct.pack("<I", 4) + b"zstd"
    chunk = struct.pack("<BQ", 6, 2**60) + sizes + struct.pack("<Q", 2**40) + b"abc"
    path.write_bytes(MAGIC + struct.pack("<BQ", 1, 8) + bytes(8) + chunk)


def other_database(path):
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE a(b)")
    database.close()


def two_recordings(path):
    path.mkdir()
    for name in ("first.mcap", "second.mcap"):
        write_bag(path / "made", drive())
        (file,) = (path / "made").glob("*.mcap")
        file.rename(path / name)
        (path / "made" / "metadata.yaml").unlink()
        (path / "made").rmdir()


REFUSED = {
    "text.mcap": (lambda path: path.write_text("hello"), "is not a bag"),
    "picture.bag": (lambda path: path.write_bytes(b"\x89PNG" + bytes(99)), "is not a bag"),
    "empty.db3": (lambda path: path.touch(), "is empty"),
    "zeros.mcap": (lambda path: path.write_bytes(bytes(9999)), "the disk was full"),
    "pipe.mcap": (os.mkfifo, "is a device, a pipe or a socket"),
    "begin.mcap": (lambda path: path.write_bytes(MAGIC), "no message could be read"),
    "cut": (lambda path: cut(path, 0.002), "no message could be read"),
    "huge.mcap": (huge_chunk, "LARGEST_CHUNK"),
    "other.db3": (other_database, "no rosbag2"),
    "old.bag": (lambda path: path.write_bytes(b"#ROSBAG V1.2\n" + bytes(99)), "is not a bag"),
}
# These hold no recording of their own.
NAMED_ONLY = {
    "absent.mcap": (lambda _: None, "There is no bag"),
    "folder": (lambda path: path.mkdir(), "is not a bag"),
    "two": (two_recordings, "holds several recordings"),
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    root = tmp_path_factory.mktemp("recordings")
    for nth, name in enumerate("abcd"):
        write_bag(root / "good" / name, drive(nth))
    for name, (make, _) in (REFUSED | NAMED_ONLY).items():
        make(root / name)
    cut(root / "half", 0.6)
    write_bag(root / "silent", [])
    write_bag(root / "short", [each for each in drive() if each[0] < 0.2])
    return root


def done_by(command, *arguments, expect):
    done = CliRunner().invoke(command, [str(argument) for argument in arguments])
    assert done.exit_code == expect, done.output
    assert "Traceback" not in done.output
    return done


@pytest.mark.parametrize("name", REFUSED | NAMED_ONLY)
def test_a_refused_recording_is_an_error_of_one_line(name, place, tmp_path):
    reason = (REFUSED | NAMED_ONLY)[name][1]
    mutate = (sim_main, "mutate", place / name, tmp_path / "out", "random_noise")
    programs = [
        ((main, "features", place / name), 2),
        ((main, "replay", place / name, "-o", tmp_path / "out.png"), 2),
        ((*mutate, "-p", "level=0.02", "--topic", "/scan"), 1),
    ]
    for program, expect in programs[1:] if name == "two" else programs:
        (line,) = done_by(*program, expect=expect).stderr.splitlines()
        assert str(place / name) in line
        assert reason in line
    assert not list(tmp_path.iterdir())


def test_features_of_a_folder_are_those_of_each_recording_in_it(place):
    done = done_by(main, "features", place / "two", "--format", "json", expect=0)
    names = [row["run_id"] for row in json.loads(done.stdout)["rows"]]
    assert names == [str(place / "two" / name) for name in ("first.mcap", "second.mcap")]


def test_refused_recordings_are_named_and_the_others_are_used(place, tmp_path):
    card = tmp_path / "robot.card"
    odd = [place / name for name in REFUSED]
    more = (place / "half", place / "short")
    output = done_by(main, "learn", place / "good", *odd, *more, "--output", card, expect=0).stdout
    assert "Learned from 5 normal recordings" in output
    for name, (_, reason) in REFUSED.items():
        assert any(f"{name}" in line and reason in line for line in output.splitlines())
    assert "short is left out of the reference: it is shorter than 0.25 s" in output

    named_only = {name: NAMED_ONLY[name] for name in ("absent.mcap", "folder")}
    named = [*odd, *(place / name for name in named_only), *more]
    named += [place / "silent", place / "good" / "a"]
    arguments = ("score", *named, "--reference", card, "--far", 0.2, "--format", "json")
    junit = tmp_path / "verdicts.xml"
    done = done_by(main, *arguments, "--junit", junit, expect=2)
    *bad, half, short, silent, good = json.loads(done.stdout)["recordings"]
    for verdict, (_, reason) in zip(bad, (REFUSED | named_only).values(), strict=True):
        assert verdict["outcome"] == "error"
        assert reason in verdict["error"]
    assert "too short to judge" in short["error"]
    assert "too short to judge" in silent["error"]
    assert any("was not finished" in caution for caution in half["cautions"])
    assert good["p_value"] is not None
    assert junit.read_text().count("<testcase") == len(named)


def test_comparing_reports_what_was_left_out(place):
    write_bag(place / "spinning", spinning())
    text = done_by(main, "compare", place / "good", place, expect=0).stdout
    for name in REFUSED:
        assert name in text
