"""All messages of a recording by any writer with any options are read, in order of time."""

import os
import shutil
import sqlite3
from functools import partial
from itertools import product
from operator import itemgetter
from pathlib import Path

import pytest
from backports import zstd
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.parts import is_recording
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.records import MOST_AT_ONCE
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from oracle_pipeline.cli import main
from tests.oracle_pipeline.bags.conftest import text
from tests.oracle_pipeline.bags.makers import STRING, McapOptions, write_db3, write_mcap, write_ros1

SECOND = 1_000_000_000
MESSAGES = [
    (f"/topic{i % 3}", 10 * SECOND + i * SECOND // 10, text(f"message {i} {'x' * (i % 50)}"))
    for i in range(60)
]
# As a recorder of several threads writes: the last of four comes first.
DISORDERED = [MESSAGES[i - i % 4 + (i + 3) % 4] for i in range(60)]

OPTIONS = [
    McapOptions(chunk_bytes, compression, checksums, summary, statistics, repeat, index)
    for chunk_bytes, compression, checksums in product([0, 1000], ["", "zstd", "lz4"], [True])
    for summary, statistics, repeat, index in [
        (True, True, True, True), (False, False, False, False), (True, False, True, True),
        (True, True, False, True), (True, True, True, False),
    ]
] + [McapOptions(checksums=False), McapOptions(compress_messages=True),
     McapOptions(0, compress_messages=True)]  # fmt: skip


def read(path, **options):
    with BagReader(path, **options) as bag:
        return [tuple(message) for message in bag.messages()], bag.losses


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("order", [MESSAGES, DISORDERED], ids=["in order", "disordered"])
def test_every_mcap_file_is_read(options, order, tmp_path):
    write_mcap(tmp_path / "a.mcap", order, options)
    assert read(tmp_path / "a.mcap", strict=True) == (MESSAGES, [])
    with BagReader(tmp_path / "a.mcap") as bag:
        assert (bag.start_ns, bag.end_ns) == (MESSAGES[0][1], MESSAGES[-1][1])
        assert {t.name: t.count for t in bag.topics.values()} == dict.fromkeys(bag.topics, 20)
        assert [m.topic for m in bag.messages(["/topic1"])] == ["/topic1"] * 20


def test_every_bag_at_hand_is_read_as_with_rosbags(any_bag):
    with Reader(any_bag) as reader:
        theirs = [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages()]
    assert read(any_bag, strict=True) == (theirs, [])


@pytest.mark.parametrize("schema", [1, 2, 3, 4])
def test_every_schema_of_sqlite_is_read(schema, tmp_path):
    write_db3(tmp_path / "a.db3", DISORDERED, schema)
    assert read(tmp_path / "a.db3", strict=True) == (MESSAGES, [])


@pytest.mark.parametrize("compression", ["", "bz2", "lz4"])
def test_every_ros1_bag_is_read(compression, tmp_path):
    write_ros1(tmp_path / "a.bag", DISORDERED, compression)
    with BagReader(tmp_path / "a.bag", strict=True) as bag:
        assert [(m.topic, m.stamp_ns) for m in bag.messages()] == [m[:2] for m in MESSAGES]
        assert {bag.deserialize(m).data[:7] for m in bag.messages()} == {"message"}


@pytest.mark.parametrize("name", ["a b.mcap", "a#1.db3", "50%.db3", "what?.db3", "x.db3.zstd",
                                  "x.mcap.zstd", "x.bag.active"])  # fmt: skip
def test_any_file_name_is_read(name, tmp_path):
    path = tmp_path / name
    plain = path.with_suffix("") if name.endswith(".zstd") else path
    if ".mcap" in name:
        write_mcap(plain, MESSAGES, McapOptions())
    elif ".db3" in name:
        write_db3(plain, MESSAGES)
    else:
        write_ros1(plain, MESSAGES)
    if plain != path:
        path.write_bytes(zstd.compress(plain.read_bytes()))
        plain.unlink()
    assert len(read(path, strict=True)[0]) == 60


def test_names_that_are_not_utf8_are_read(tmp_path):
    for suffix, write in (("db3", write_db3), ("bag", write_ros1)):
        path = tmp_path / os.fsdecode(b"caf\xe9." + suffix.encode())
        write(tmp_path / "plain", MESSAGES)
        (tmp_path / "plain").rename(path)
        assert len(read(path)[0]) == 60


@pytest.mark.parametrize("folder", ["bag", "folder.bag", "folder.mcap"])
def test_a_folder_is_one_recording_whatever_metadata_says(folder, tmp_path, write_bag):
    """Parts and topics that it does not list are read; those of other recordings are not."""
    bag = write_bag(tmp_path / folder)
    (bag / "metadata.yaml").unlink()
    next(bag.glob("*.mcap")).unlink()
    for part in range(12):  # ten and more: not in order of name
        write_mcap(bag / f"x_{part}.mcap", MESSAGES[5 * part : 5 * part + 5], McapOptions())
    assert read(bag) == (MESSAGES, [])
    assert is_recording(bag)
    write_bag(tmp_path / "other")
    shutil.copy(tmp_path / "other" / "metadata.yaml", bag)  # of another recording
    messages, losses = read(bag)
    assert messages == MESSAGES
    assert "other_0.mcap, which does not exist" in losses[0]
    with pytest.raises(BagError, match=r"incomplete.*other_0\.mcap"):
        BagReader(bag, strict=True)


def test_a_renamed_recording_is_complete(tmp_path, write_bag):
    bag = write_bag(tmp_path / "bag")
    (file,) = bag.glob("*.mcap")
    messages, _ = read(bag)
    file.rename(bag / "renamed.mcap")
    assert read(bag, strict=True) == (messages, [])
    with BagReader(bag) as reader:
        assert "the recording was renamed" in " ".join(reader.notes)
    write_mcap(bag / "renamed.mcap", messages[1:], McapOptions())  # a message less
    with pytest.raises(BagError, match=rf"incomplete.*{file.name}, which does not exist"):
        BagReader(bag, strict=True)
    (bag / "renamed.mcap").unlink()
    with pytest.raises(BagError, match=rf"not a bag: metadata\.yaml names {file.name}.*Copy"):
        BagReader(bag)


def test_what_metadata_claims_is_compared_with_what_is_read(tmp_path, write_bag):
    bag = write_bag(tmp_path / "bag", "sqlite3")
    whole = read(bag, strict=True)[0]
    file, metadata = next(bag.glob("*.db3")), (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(metadata.replace("rosgraph_msgs/msg/Clock", "a_msgs/msg/A"))
    with BagReader(bag) as reader:
        assert "says that /clock has type a_msgs/msg/A; it has rosgraph" in " ".join(reader.notes)
        assert " ".join(reader.notes).count("no checksum") == 1
    (bag / "metadata.yaml").write_text(metadata)
    with sqlite3.connect(file) as database:
        database.execute("DELETE FROM messages WHERE id % 3 = 0")
    messages, (loss,) = read(bag)
    assert f"claims {len(whole)} messages, and the files have {len(messages)}: /" in loss
    with pytest.raises(BagError, match=r"is incomplete\. metadata\.yaml claims"):
        BagReader(bag, strict=True)
    with sqlite3.connect(file) as database:
        database.execute("UPDATE messages SET timestamp = timestamp + 5000000000")
    with BagReader(bag) as reader:
        assert "first message is 5.0 s later than metadata.yaml says" in " ".join(reader.notes)


def test_an_uncompressed_ros1_chunk_is_as_large_as_it_is(tmp_path):
    write_ros1(tmp_path / "a.bag", MESSAGES)
    expected, data = read(tmp_path / "a.bag"), bytearray((tmp_path / "a.bag").read_bytes())
    at = data.index(b"size=") + len(b"size=")
    data[at : at + 4] = (2**31).to_bytes(4, "little")
    (tmp_path / "a.bag").write_bytes(data)
    assert read(tmp_path / "a.bag") == expected


POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"


def test_a_git_lfs_pointer_is_refused_with_the_command_that_gets_the_bag(tmp_path):
    (tmp_path / "a.mcap").write_text(POINTER)
    for path in (tmp_path / "a.mcap", tmp_path):
        with pytest.raises(BagError, match="Git LFS pointer.*git lfs pull"):
            BagReader(path)


@pytest.mark.parametrize("name", ["a.bag", "a.ulg", "a.csv", "a.parquet"])
def test_commands_refuse_a_git_lfs_pointer_to_a_log_or_a_card(name, tmp_path):
    (tmp_path / name).write_text(POINTER)
    card = tmp_path / "normal.card"
    card.write_text(POINTER)
    of_log = ["features", str(tmp_path / name)]
    for command in (of_log, ["score", str(tmp_path / name), "--reference", str(card)]):
        done = CliRunner().invoke(main, command)
        assert done.exit_code == 2
        assert "is only a Git LFS pointer; get the file itself with `git lfs pull`" in done.stderr


def test_a_part_that_cannot_be_read_is_named_and_the_others_are_read(tmp_path):
    for part in range(3):
        write_mcap(tmp_path / f"x_{part}.mcap", MESSAGES[20 * part : 20 * part + 20], McapOptions())
    (tmp_path / "x_1.mcap").write_bytes(bytes(1000))
    messages, (loss,) = read(tmp_path)
    assert messages == MESSAGES[:20] + MESSAGES[40:]
    assert "x_1.mcap cannot be read" in loss
    assert "begins with zeros" in loss


def test_several_recordings_in_a_folder_are_several(tmp_path):
    for name in ("a.mcap", "b.mcap"):
        write_mcap(tmp_path / name, MESSAGES, McapOptions())
    with pytest.raises(BagError, match=r"several recordings: a\.mcap, b\.mcap"):
        BagReader(tmp_path)
    assert not is_recording(tmp_path)
    assert is_recording(tmp_path / "a.mcap")


def test_a_half_compressed_part_gives_way_to_its_original(tmp_path):
    write_db3(tmp_path / "x_0.db3", MESSAGES)
    (tmp_path / "x_0.db3.zstd").write_bytes(
        zstd.compress((tmp_path / "x_0.db3").read_bytes())[:500]
    )
    assert read(tmp_path) == (MESSAGES, [])


def test_the_rarer_type_of_a_topic_with_two_types_is_reported(tmp_path, write_bag):
    write_mcap(tmp_path / "a_0.mcap", [("/clock", m[1], m[2]) for m in MESSAGES], McapOptions())
    shutil.copy(next(write_bag(tmp_path / "bag").glob("*.mcap")), tmp_path / "a_1.mcap")
    shutil.rmtree(tmp_path / "bag")
    with BagReader(tmp_path) as bag:
        assert bag.topics["/clock"].count == 60
        assert "20 messages of the latter are not used" in " ".join(bag.notes)


@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.bag"])
def test_names_of_topics_are_completed_in_every_format(name, tmp_path):
    write = {".mcap": partial(write_mcap, options=McapOptions()), ".db3": write_db3,
             ".bag": write_ros1}[Path(name).suffix]  # fmt: skip
    spelled = {"/topic0": "topic0", "/topic1": "topic1/", "/topic2": "//topic2"}
    write(tmp_path / name, [(spelled[topic], *rest) for topic, *rest in MESSAGES])
    with BagReader(tmp_path / name, strict=True) as bag:
        assert {topic.name: topic.count for topic in bag.topics.values()} == dict.fromkeys(
            spelled, 20
        )
        assert [(m.topic, m.stamp_ns) for m in bag.messages()] == [m[:2] for m in MESSAGES]
        assert [m.topic for m in bag.messages(["/topic1"])] == ["/topic1"] * 20
        seen = bag.renamed({"/topic0": "/new"})
        assert [m.topic for m in seen.messages()] == ["/new"] * 20
        assert seen.recorded("/new") == "/topic0"


def test_of_two_spellings_of_a_topic_one_is_read_and_the_other_reported(tmp_path):
    bare = [("odom", *rest) for _, *rest in MESSAGES]
    write_db3(tmp_path / "a.db3", [("/odom", 0, text("another")), *bare, ("/odom", 7, text(""))])
    with BagReader(tmp_path / "a.db3", strict=True) as bag:
        assert [tuple(m) for m in bag.messages()] == [("/odom", *rest) for _, *rest in bare]
        assert bag.message_count == bag.topics["/odom"].count == len(bare)
        _, note = bag.notes
    assert note == (
        f"/odom was recorded as odom ({STRING}) and as /odom ({STRING}); the 2 messages of the "
        "latter are not used."
    )


def test_ground_truth_without_the_leading_slash_is_dropped(tmp_path):
    write_db3(tmp_path / "a.db3", [(GROUND_TRUTH_TOPIC[1:], 1, text("malicious")), MESSAGES[0]])
    with BagReader(tmp_path / "a.db3") as bag:
        assert list(bag.topics) == ["/topic0"]


def test_profiles_of_metadata_belong_to_a_name_as_it_was_recorded(tmp_path, write_bag):
    bag = write_bag(tmp_path / "bag", "sqlite3")
    with BagReader(bag) as reader:
        profiles = reader.topics["/chatter"].qos
    database = sqlite3.connect(next(bag.glob("*.db3")))
    database.execute("UPDATE topics SET name = 'chatter', offered_qos_profiles = '' WHERE id = 2")
    database.commit()
    database.close()
    file = bag / "metadata.yaml"
    file.write_text(file.read_text().replace("/chatter", "chatter"))
    with BagReader(bag) as reader:
        assert reader.topics["/chatter"].qos == profiles != ()


def test_a_topic_that_a_disordered_recording_lacks_has_no_messages(tmp_path):
    write_mcap(tmp_path / "a.mcap", DISORDERED, McapOptions(summary=False))
    with BagReader(tmp_path / "a.mcap") as bag:
        assert list(bag.messages(["/none"])) == []


@settings(max_examples=60, deadline=None)
@given(
    stamps=st.lists(st.integers(0, 9), min_size=1, max_size=12),
    chunk_bytes=st.sampled_from([0, 1, 100]),
    summary=st.booleans(),
)
def test_any_order_of_stamps_is_sorted_and_equal_ones_stay(
    stamps, chunk_bytes, summary, tmp_path_factory
):
    messages = [(f"/topic{i % 2}", stamp, text(str(i))) for i, stamp in enumerate(stamps)]
    path = tmp_path_factory.mktemp("order") / "a.mcap"
    write_mcap(path, messages, McapOptions(chunk_bytes, summary=summary))
    assert read(path)[0] == sorted(messages, key=itemgetter(1))


@pytest.mark.parametrize("indexed", [True, False])
def test_a_chunk_of_many_small_messages_is_read_completely_and_sorted(indexed, tmp_path):
    path, count = tmp_path / "a.mcap", MOST_AT_ONCE + 10
    messages = [("/t", count - number, b"\0\1\0\0\1\0\0\0\0") for number in range(count)]
    write_mcap(path, messages, McapOptions(2**30, "zstd", statistics=indexed))
    with BagReader(path) as bag:
        assert max(len(batch.topics) for batch in bag.batches()) == MOST_AT_ONCE
        assert [message.stamp_ns for message in bag.messages()] == list(range(1, count + 1))
