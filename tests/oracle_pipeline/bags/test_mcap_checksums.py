"""An MCAP file has every possible checksum, and content that differs from it is an error."""

import zlib

import numpy as np
import pytest
from mcap.reader import NonSeekingReader

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.reader import BagReader


@pytest.fixture
def file(write_bag, tmp_path):
    return next(write_bag(tmp_path / "bag").glob("*.mcap"))


def read(path):
    """Return all that features could see of a bag."""
    with BagReader(path) as bag:
        definitions = {name: bag.definition(topic.msgtype) for name, topic in bag.topics.items()}
        return bag.topics, definitions, list(bag.messages())


def test_the_reference_reader_finds_every_checksum_right(file):
    """It passes over checksums that are 0, and over that of the summary."""
    with file.open("rb") as source:
        reader = NonSeekingReader(source, validate_crcs=True)
        assert len(list(reader.iter_messages())) == 40
    content = file.read_bytes()
    summary_start = int.from_bytes(content[-28:-20], "little")
    assert content[-12:-8] == zlib.crc32(content[summary_start:-12]).to_bytes(4, "little")
    chunk = content.index(b"zstd") - 4 - 4
    assert content[chunk : chunk + 4] != bytes(4), "no checksum of the chunk"
    data_end = content.index(b"\x0f" + (4).to_bytes(8, "little"))
    assert content[data_end + 9 : data_end + 13] != bytes(4), "no checksum of the data"


def test_no_flipped_bit_of_a_bag_gives_other_messages(file):
    content, expected = file.read_bytes(), read(file)
    refused = 0
    for at in np.random.default_rng(15).choice(8 * len(content), 300, replace=False):
        flipped = bytearray(content)
        flipped[at // 8] ^= 1 << at % 8
        file.write_bytes(flipped)
        try:
            found = read(file)
        except BagError:
            refused += 1
        else:
            assert found == expected, f"bit {at}"
    assert refused > 100  # the others are in unused parts, such as an index of messages


def test_a_file_without_checksums_is_read(file):
    """The recorder of ROS 2 Humble writes none."""
    expected = read(file)
    content = bytearray(file.read_bytes())
    content[-12:-8] = bytes(4)
    file.write_bytes(content)
    assert read(file) == expected
