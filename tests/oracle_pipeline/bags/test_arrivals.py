"""Recordings in a folder: every name has a unique key, and unfinished ones are detected."""

import os
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.arrivals import Arrival, arrivals, key_of
from tests.oracle_pipeline.features.conftest import drive, write_bag

# Whatever Linux allows as a name of a file, UTF-8 or not.
names = (
    st.binary(min_size=1, max_size=255)
    .filter(lambda raw: b"/" not in raw and b"\0" not in raw)
    .map(os.fsdecode)
)


def only(folder: Path) -> Arrival:
    (arrival,) = arrivals(folder).found
    return arrival


@pytest.fixture
def inbox(tmp_path: Path) -> Path:
    folder = tmp_path / "inbox"
    folder.mkdir()
    return folder


@given(names)
def test_a_key_is_plain_and_short_whatever_the_name(name: str) -> None:
    key = key_of(name)
    assert re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,112}", key)
    assert ".." not in key


@given(names, names)
def test_two_names_have_two_keys(one: str, other: str) -> None:
    assert (key_of(one) == key_of(other)) == (one == other)


@given(names)
def test_a_name_that_equals_the_key_of_another_has_a_different_key(name: str) -> None:
    key = key_of(name)
    assert key == name or key_of(key) != key


def test_a_bag_without_metadata_is_unfinished_until_its_file_has_its_end(inbox: Path) -> None:
    write_bag(inbox / "bag", drive())
    assert only(inbox).is_finished()
    (inbox / "bag" / "metadata.yaml").unlink()  # rosbag2 writes it last
    assert only(inbox).is_finished()
    (mcap,) = (inbox / "bag").iterdir()
    whole = mcap.read_bytes()
    mcap.write_bytes(whole[:-8])
    assert not only(inbox).is_finished()
    mcap.rename(inbox / "alone.mcap")
    assert not only(inbox).is_finished()
    (inbox / "alone.mcap").write_bytes(whole)
    assert only(inbox).is_finished()


def test_a_sqlite_bag_without_metadata_is_unfinished(inbox: Path) -> None:
    write_bag(inbox / "bag", drive(), "sqlite3")
    assert only(inbox).is_finished()
    (inbox / "bag" / "metadata.yaml").unlink()
    assert not only(inbox).is_finished()


@pytest.mark.parametrize("change", ["grow", "touch", "add"])
def test_any_change_to_a_file_changes_the_fingerprint(inbox: Path, change: str) -> None:
    write_bag(inbox / "bag", drive())
    before = only(inbox)
    (mcap,) = (inbox / "bag").glob("*.mcap")
    if change == "grow":
        status = mcap.stat()
        mcap.write_bytes(mcap.read_bytes() + b"\0")
        os.utime(mcap, ns=(status.st_atime_ns, status.st_mtime_ns))
    elif change == "touch":
        os.utime(mcap, (1.0, 1.0))
    else:
        (inbox / "bag" / "bag_1.mcap").write_bytes(b"")
    after = only(inbox)
    assert after.key == before.key
    assert after.fingerprint != before.fingerprint


def test_files_that_are_no_recordings_are_left_out_without_blocking(inbox: Path) -> None:
    write_bag(inbox / ".copying", drive())
    (inbox / "notes.txt").write_text("no recording")
    (inbox / "empty").mkdir()
    os.mkfifo(inbox / "pipe.mcap")  # opening it would wait for a writer
    (inbox / "folder").mkdir()
    os.mkfifo(inbox / "folder" / "pipe.mcap")
    (inbox / "broken.mcap").symlink_to(inbox / "nowhere")
    (inbox / "loop.mcap").symlink_to(inbox / "loop.mcap")
    looked = arrivals(inbox)
    assert [arrival.name for arrival in looked.found] == ["folder"]  # the reader will refuse it
    assert len(looked.faults) == 1
    assert looked.faults[0].startswith("loop.mcap cannot be inspected")


def test_a_name_that_is_not_utf8_is_reported_in_plain_text(inbox: Path) -> None:
    name = b"bag\xff\x1b[2J"
    write_bag(inbox / "bag", drive())
    (inbox / "bag").rename(inbox / os.fsdecode(name))
    arrival = only(inbox)
    assert arrival.name == r"bag\udcff\x1b[2J"
    assert arrival.key.startswith("bag-2J-")
