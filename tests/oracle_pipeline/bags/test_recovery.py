"""A recording that was not finished: nothing before the cut is lost, nothing is invented."""

import shutil
import sqlite3
import struct
from collections import Counter

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.reader import BagReader
from tests.oracle_pipeline.bags.makers import McapOptions, write_db3, write_mcap, write_ros1
from tests.oracle_pipeline.bags.test_recordings import MESSAGES, read

OPTIONS = st.builds(
    McapOptions, st.sampled_from([0, 1, 500, 10_000]), st.sampled_from(["", "zstd", "lz4"]),
    st.booleans(), st.booleans(), st.booleans(), st.booleans(), st.booleans(), st.booleans(),
)  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("cut")


@settings(max_examples=150, deadline=None)
@given(options=OPTIONS, share=st.floats(0, 1, exclude_max=True), zeros=st.booleans())
def test_an_mcap_file_that_is_cut_anywhere(options, share, zeros, place):
    path = place / "a.mcap"
    complete = write_mcap(path, MESSAGES, options)
    data = path.read_bytes()
    cut = int(share * len(data))
    path.write_bytes(data[:cut] + bytes(1000 if zeros else 0))  # a disk that was full ends so
    # Zeros at the end of the last message cannot be distinguished from those of the disk.
    before = max(0, sum(end <= cut for end in complete) - zeros)
    try:
        messages, (loss,) = read(path)
    except BagError:
        assert not before
        return
    assert messages == MESSAGES[: len(messages)]
    assert len(messages) >= before
    assert f"{len(messages)} messages were read, up to {messages[-1][1]} ns (1970-" in loss
    with pytest.raises(BagError, match="is incomplete"):
        BagReader(path, strict=True)


@settings(max_examples=60, deadline=None)
@given(
    compression=st.sampled_from(["", "bz2", "lz4"]),
    share=st.floats(0, 1, exclude_max=True),
    zeros=st.booleans(),
)
@example(compression="", share=0.998, zeros=True)  # in the counts of the last chunk
def test_a_ros1_bag_that_is_cut_anywhere(compression, share, zeros, place):
    path = place / "a.bag"
    path.unlink(missing_ok=True)
    write_ros1(path, MESSAGES, compression)
    data = path.read_bytes()
    _, index = index_of(data)
    cut = int(share * len(data))
    path.write_bytes(data[:cut] + bytes(1000 if zeros else 0))
    try:
        messages, (loss,) = read(path)
    except BagError:
        assert cut <= index
        return
    assert [m[:2] for m in messages] == [m[:2] for m in MESSAGES[: len(messages)]]
    assert len(messages) == 60 or cut <= index
    assert f"{len(messages)} messages were read" in loss


@given(zeros=st.integers(1, 5_000))
def test_a_ros1_bag_with_zeros_before_its_index(zeros, place):
    """As where a tool gave a topic a shorter name."""
    path = place / "padded.bag"
    path.unlink(missing_ok=True)
    write_ros1(path, MESSAGES)
    data = bytearray(path.read_bytes())
    at, index = index_of(data)
    struct.pack_into("<Q", data, at, index + zeros)
    path.write_bytes(data[:index] + bytes(zeros) + data[index:])
    messages, losses = read(path)
    assert [m[:2] for m in messages] == [m[:2] for m in MESSAGES]
    assert losses == []


def index_of(ros1):
    """Return where a ROS 1 bag states the place of its index, and that place."""
    at = ros1.index(b"index_pos=") + len("index_pos=")
    return at, struct.unpack_from("<Q", ros1, at)[0]


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_database_that_is_cut_anywhere(share, place):
    path = place / "a.db3"
    path.unlink(missing_ok=True)
    many = [(topic, stamp + i, data * 20) for i in range(8) for topic, stamp, data in MESSAGES]
    write_db3(path, many)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    try:
        messages, losses = read(path)
    except BagError:
        assert share < 0.2
        return
    assert not Counter(messages) - Counter(many)
    assert len(messages) >= 0.8 * (share - 0.1) * len(many)
    assert len(messages) == len(many) or losses


def test_a_cut_database_is_read_as_far_as_its_pages_go(tmp_path):
    """The top of a deep tree is late in the file, where it is lost first."""
    path, many = tmp_path / "a.db3", [m for i in range(50) for m in MESSAGES]
    write_db3(path, MESSAGES[:1])
    database = sqlite3.connect(path)
    database.executescript("PRAGMA page_size = 512; VACUUM")
    insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)"
    rows = [(stamp, data * (40 if stamp % 7 else 1)) for _, stamp, data in many]
    database.executemany(insert, rows)
    database.commit()
    database.close()
    data, held = path.read_bytes(), Counter([(m[1], m[2]) for m in MESSAGES[:1]] + rows)
    for share in (0.1, 0.3, 0.5, 0.7, 0.9):
        path.write_bytes(data[: int(share * len(data))])
        messages, _ = read(path)
        assert not Counter((m[1], m[2]) for m in messages) - held
        assert len(messages) >= (share - 0.03) * len(rows)


@pytest.mark.parametrize("write", [write_db3, write_ros1])
def test_a_flipped_or_cut_file_is_an_error_or_gives_messages(write, tmp_path):
    write(tmp_path / "whole", MESSAGES)
    whole, rng = (tmp_path / "whole").read_bytes(), np.random.default_rng(0)
    for number in range(60):
        damaged = bytearray(whole)
        damaged[int(rng.integers(16, len(whole)))] ^= 1 << int(rng.integers(8))
        cut = len(whole) if number % 2 else int(rng.integers(16, len(whole)))
        (tmp_path / "a").write_bytes(damaged[:cut])
        try:
            messages, losses = read(tmp_path / "a")
        except BagError as error:
            told = str(error)
            assert str(tmp_path / "a") in told
        else:
            assert len(messages) == 60 or losses


@pytest.mark.parametrize("mode", ["WAL", "DELETE"])
def test_a_database_that_was_not_closed(mode, tmp_path):
    write_db3(tmp_path / "a.db3", MESSAGES[:20])
    (tmp_path / "bag").mkdir()
    database = sqlite3.connect(tmp_path / "a.db3")
    database.execute(f"PRAGMA journal_mode = {mode}")
    database.execute("PRAGMA cache_size = 1")  # so that DELETE writes before it commits
    insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)"
    database.executemany(insert, [(m[1], m[2]) for m in MESSAGES[20:40]])
    database.commit()
    if mode == "DELETE":
        database.executemany(insert, [(m[1], m[2] * 300) for m in MESSAGES[40:]])
    for file in tmp_path.glob("a.db3*"):  # as they are when the power fails
        shutil.copy(file, tmp_path / "bag")
    database.close()
    held = {file.name: file.read_bytes() for file in (tmp_path / "bag").iterdir()}
    assert len(held) > 1
    messages, losses = read(tmp_path / "bag")
    assert [m[1:] for m in messages] == [m[1:] for m in MESSAGES[:40]]
    assert "was not closed" in losses[0]
    assert {f.name: f.read_bytes() for f in (tmp_path / "bag").iterdir()} == held


def test_a_broken_chunk_in_a_finished_file_is_an_error(tmp_path):
    path = tmp_path / "a.mcap"
    write_mcap(path, MESSAGES, McapOptions())
    data = bytearray(path.read_bytes())
    data[data.index(b"message 30")] ^= 1
    path.write_bytes(data)
    with (
        BagReader(path) as bag,
        pytest.raises(BagError, match=r"a\.mcap is corrupt: the chunk at byte \d+ differs from"),
    ):
        list(bag.messages())
