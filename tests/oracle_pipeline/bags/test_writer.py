import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.reader import BagReader, content_hash
from oracle_pipeline.bags.types import TypeDefinition
from oracle_pipeline.bags.writer import BagWriter

CLOCK = "rosgraph_msgs/msg/Clock"
STORAGES = ("mcap", "sqlite3")

recordings = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 10**9), st.binary(max_size=40)), max_size=40
)


@pytest.mark.parametrize("storage", STORAGES)
def test_written_messages_are_read_back_in_order(storage, tmp_path_factory):
    @settings(max_examples=25)
    @given(recordings)
    def check(recording):
        path = tmp_path_factory.mktemp("bag") / "bag"
        stamp_ns, written = 0, []
        with BagWriter(path, storage) as bag:
            for name in range(4):
                bag.add_topic(f"/topic{name}", CLOCK, [])
            for name, step_ns, data in recording:
                stamp_ns += step_ns
                bag.write(f"/topic{name}", stamp_ns, data)
                written.append((f"/topic{name}", stamp_ns, data))
        with BagReader(path) as read:
            assert list(read.messages()) == written
            assert {n: t.count for n, t in read.topics.items()} == bag.counts
            assert (read.start_ns, read.end_ns) == (
                (written[0][1], written[-1][1]) if written else (0, 0)
            )
        assert content_hash(path) == bag.content_hash
        assert bag.message_bytes == sum(len(data) for _, _, data in written)

    check()


@pytest.mark.parametrize("storage", STORAGES)
def test_equal_calls_give_equal_bytes(storage, write_bag, tmp_path):
    once, again = write_bag(tmp_path / "a" / "bag", storage), write_bag(tmp_path / "bag", storage)
    names = sorted(path.name for path in once.iterdir())
    assert names == [f"bag_0.{'mcap' if storage == 'mcap' else 'db3'}", "metadata.yaml"]
    for name in names:
        assert (once / name).read_bytes() == (again / name).read_bytes()


@settings(max_examples=30)
@given(recordings, recordings)
def test_the_hash_distinguishes_recordings(tmp_path_factory, one, other):
    def digest(recording):
        with BagWriter(tmp_path_factory.mktemp("bag") / "bag") as bag:
            for name, stamp_ns, data in recording:
                bag.add_topic(f"/topic{name}", CLOCK, [])
                bag.write(f"/topic{name}", stamp_ns, data)
        return bag.content_hash

    assert (digest(one) == digest(other)) == (one == other)


def test_metadata_is_what_humble_reads(write_bag, tmp_path):
    text = (write_bag(tmp_path / "bag") / "metadata.yaml").read_text("utf-8")
    bag = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert bag["version"] == 8
    assert bag["relative_file_paths"] == [bag["files"][0]["path"]] == ["bag_0.mcap"]
    topics = {t["topic_metadata"]["name"]: t for t in bag["topics_with_message_count"]}
    assert topics["/chatter"]["message_count"] == 20
    profiles = yaml.safe_load(topics["/chatter"]["topic_metadata"]["offered_qos_profiles"])
    assert [profile["depth"] for profile in profiles] == [10, 5]
    assert profiles[0]["reliability"] == 1


@pytest.mark.parametrize("storage", STORAGES)
def test_profiles_of_publishers_are_kept_until_the_first_message(storage, qos, tmp_path):
    with BagWriter(tmp_path / "bag", storage) as bag:
        bag.add_topic("/a", CLOCK, [qos(1)])
        bag.add_topic("/a", CLOCK, [qos(2)])
        bag.add_topic("/silent", CLOCK, [qos(1)])
        bag.write("/a", 0, b"")
        bag.add_topic("/a", CLOCK, [qos(3)])
        bag.add_topic("/silent", CLOCK, [qos(2)])
        bag.write("/a", 1, b"")
    with BagReader(tmp_path / "bag") as read:
        depths = {name: [q.depth for q in topic.qos] for name, topic in read.topics.items()}
        assert depths == {"/a": [1, 2], "/silent": [1, 2]}
        assert len(list(read.messages())) == 2


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_that_fails_leaves_nothing(storage, tmp_path):
    def fail() -> None:
        with BagWriter(tmp_path / "bag", storage) as bag:
            bag.add_topic("/a", CLOCK, [])
            bag.write("/a", 0, b"")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_wrong_calls_are_named(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/a", CLOCK, [])
        with pytest.raises(BagError, match=r"/b is unknown.*add_topic"):
            bag.write("/b", 0, b"")
        with pytest.raises(BagError, match=r"/a is of type rosgraph_msgs/msg/Clock.*std_msgs"):
            bag.add_topic("/a", "std_msgs/msg/String", [])
        with pytest.raises(BagError, match="no_msgs/msg/Nothing"):
            bag.add_topic("/c", "no_msgs/msg/Nothing", [])
    with pytest.raises(BagError, match="exists already"):
        BagWriter(tmp_path / "bag")


def run_python(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", textwrap.dedent(code), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_full_disk_is_reported_and_leaves_nothing(storage, tmp_path):
    code = """
        import os, resource, signal, sys
        from pathlib import Path
        from oracle_pipeline.bags.errors import BagError
        from oracle_pipeline.bags.writer import BagWriter

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write beyond the limit fails instead
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
        try:
            with BagWriter(Path(sys.argv[1]), sys.argv[2]) as bag:
                bag.add_topic("/a", "rosgraph_msgs/msg/Clock", [])
                for stamp_ns in range(1000):
                    bag.write("/a", stamp_ns, os.urandom(10_000))
        except BagError as error:
            print(error)
    """
    done = run_python(code, str(tmp_path / "bag"), storage)
    assert f"Could not write the bag {tmp_path / 'bag'}" in done.stdout, done.stderr
    assert "free space" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_killed_writer_leaves_no_bag(tmp_path: Path):
    code = """
        import os, signal, sys
        from pathlib import Path
        from oracle_pipeline.bags.writer import BagWriter

        with BagWriter(Path(sys.argv[1])) as bag:
            bag.add_topic("/a", "rosgraph_msgs/msg/Clock", [])
            bag.write("/a", 0, b"data")
            os.kill(os.getpid(), signal.SIGKILL)
    """
    assert run_python(code, str(tmp_path / "bag")).returncode == -signal.SIGKILL
    assert not (tmp_path / "bag").exists()


FOREIGN = "made_up_msgs/msg/Reading"
FOREIGN_TEXT = (
    "float64 value\nmade_up_msgs/Unit unit\n" + "=" * 80 + "\nMSG: made_up_msgs/Unit\nstring name\n"
)
FOREIGN_IDL = "module made_up_msgs { module msg { struct Reading { double value; }; }; };"


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("text", ["", FOREIGN_TEXT], ids=["no definition", "definition"])
def test_messages_of_a_type_that_only_the_bag_knows_are_copied_with_it(storage, text, tmp_path):
    defined = TypeDefinition(text, "")
    with BagWriter(tmp_path / "one", storage) as bag:
        bag.add_topic("/reading", FOREIGN, [], defined)
        bag.write("/reading", 5, b"\0\1\0\0payload.")
    with BagReader(tmp_path / "one") as one, BagWriter(tmp_path / "two", storage) as two:
        two.add_topic("/reading", FOREIGN, [], one.definition(FOREIGN))
        for message in one.messages():
            two.write(*message)
    assert content_hash(tmp_path / "one") == content_hash(tmp_path / "two")
    with BagReader(tmp_path / "two") as two:
        assert two.topics["/reading"].msgtype == FOREIGN
        assert two.definition(FOREIGN).text == text


def test_an_idl_definition_is_one_in_the_copy_too(tmp_path):
    heading = "=" * 80 + f"\nIDL: {FOREIGN}\n"
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/reading", FOREIGN, [], TypeDefinition(heading + FOREIGN_IDL, ""))
    with BagReader(tmp_path / "bag") as bag:
        assert bag.definition(FOREIGN).text == heading + FOREIGN_IDL
        assert FOREIGN in bag.typestore(FOREIGN).fielddefs


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_does_not_depend_on_how_many_messages_are_stored_at_a_time(
    storage, tmp_path, monkeypatch
):
    hashes, contents = [], []
    for size in (0, 5_000, 2**18, 2**30):
        monkeypatch.setattr("oracle_pipeline.bags.writer._BATCH_BYTES", size)
        path = tmp_path / str(size) / "bag"
        with BagWriter(path, storage) as bag:
            for number in range(3000):  # more than a chunk
                topic = f"/topic{number % 7 if number > 100 else 0}"
                bag.add_topic(topic, CLOCK, [])
                bag.write(topic, 10**9 - number % 5, bytes(number % 1500))
            hashes.append(bag.content_hash)
        with BagReader(path) as read:
            contents.append([(m.topic, m.stamp_ns, bytes(m.data)) for m in read.messages()])
        if storage == "mcap":
            contents[-1].append(next(path.glob("*.mcap")).read_bytes())
    assert hashes == hashes[:1] * 4
    assert contents == contents[:1] * 4
