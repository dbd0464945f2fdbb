"""The claims of a broken or hostile file cost neither memory nor time; the error names it."""

import os
import resource
import struct
import subprocess
import sys

import pytest

from oracle_pipeline.bags import bounded_yaml
from oracle_pipeline.bags.errors import BagError, GraphError
from oracle_pipeline.bags.graph_files import read_gexf
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.writer import BagWriter, TypeDefinition
from tests.oracle_pipeline.bags.conftest import text
from tests.oracle_pipeline.bags.makers import MAGIC, McapOptions, write_mcap
from tests.oracle_pipeline.bags.test_recordings import MESSAGES

TYPE = "my_msgs/msg/Odd"
LINE = "=" * 80 + "\n"
NESTED = "".join(f"{LINE}MSG: my_msgs/L{i}\nL{i + 1}[10] x\n" for i in range(30))

READ = """
import re, sys
from oracle_pipeline.bags.errors import BagError
from oracle_pipeline import features
from oracle_pipeline.opened_run import open_run
try:
    with open_run(__import__("pathlib").Path(sys.argv[1])) as run:
        features.extract(run, features.build_manager())
except BagError as error:
    print(error)
# Of this program alone: ru_maxrss would count the process that it was forked from.
print(int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) // 1024)
"""


def peak_mib(path):
    done = subprocess.run(
        [sys.executable, "-c", READ, path], capture_output=True, text=True, check=True
    )
    *said, peak = done.stdout.splitlines()
    return " ".join(said), int(peak)


@pytest.mark.parametrize("kind", ["pipe", "device", "socket"])
def test_a_path_that_is_no_file_is_refused(kind, tmp_path):
    path = tmp_path / "a.mcap"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        import socket

        socket.socket(socket.AF_UNIX).bind(str(path))
    with pytest.raises(BagError, match="is a device, a pipe or a socket"):
        BagReader(path)


@pytest.mark.parametrize(("size", "named"), [(2**40, "LARGEST_CHUNK"), (2**63, "LARGEST_CHUNK")])
def test_a_chunk_that_claims_too_much_is_refused(size, named, tmp_path):
    path = tmp_path / "a.mcap"
    write_mcap(path, MESSAGES, McapOptions(summary=False))
    data = bytearray(path.read_bytes())
    at = data.index(b"\x06", len(MAGIC) + 20)
    struct.pack_into("<Q", data, at + 9 + 16, size)
    path.write_bytes(data)
    with pytest.raises(BagError, match=named):
        BagReader(path)


@pytest.mark.slow
def test_many_tiny_messages_take_little_memory_each(tmp_path):
    """A mebibyte for 8,700 of them: as many as fit into 200 MB take less than a gibibyte."""
    many = 1_000_000
    for name, count in (("few", 100), ("many", many)):
        with BagWriter(tmp_path / name) as writer:
            writer.add_topic("/tick", "std_msgs/msg/Int8", [])
            for number in range(count):
                writer.write("/tick", number * 10_000, b"\0\1\0\0\1")
    (_, base), (said, peak) = (peak_mib(tmp_path / name) for name in ("few", "many"))
    assert not said
    assert peak - base < many * 120 / 2**20


@pytest.mark.slow
def test_small_files_that_unfold_stay_below_a_gibibyte(tmp_path):
    """A thousand chunks of zeros: 60 kB on disk, gigabytes of them."""
    path = tmp_path / "a.mcap"
    big = b"\0\1\0\0" + bytes(20_000_000)
    write_mcap(path, [("/a", i, big) for i in range(60)], McapOptions(1, "zstd"))
    assert path.stat().st_size < 1_000_000
    said, peak = peak_mib(path)
    assert not said
    assert peak < 1024


def test_a_compressed_file_that_becomes_too_large_is_refused(tmp_path, monkeypatch):
    from backports import zstd

    monkeypatch.setattr("oracle_pipeline.bags.compression._SMALLEST_LIMIT", 10**6)
    (tmp_path / "a.mcap.zstd").write_bytes(zstd.compress(MAGIC + bytes(50_000_000)))
    with pytest.raises(BagError, match="LARGEST_EXPANSION"):
        BagReader(tmp_path / "a.mcap.zstd")


@pytest.mark.parametrize(
    ("definition", "reason"),
    [
        ("Odd x\n", "contains itself"),
        ("Nobody x\n", "uses my_msgs/msg/Nobody, which neither the bag nor we define"),
        (f"L0 x\n{NESTED}{LINE}MSG: my_msgs/L30\nint8 x\n", "MOST_FIELDS"),
        ("int8 x\n" * 100_000, "LARGEST_DEFINITION"),
        (f"Empty[] x\n{LINE}MSG: my_msgs/Empty\nint8 A=1\n", "which has no field"),
    ],
)  # fmt: skip
def test_a_definition_that_unfolds_is_refused(definition, reason, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/odd", TYPE, [], TypeDefinition(definition, ""))
        writer.write("/odd", 0, text("x"))
    with BagReader(tmp_path / "bag") as bag:
        (message,) = bag.messages()
        with pytest.raises(BagError, match=reason):
            bag.deserialize(message)


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", ["[" * 50, "a: &a [x]\nb: *a", "- x\n" * 1_000_001, "x" * (16 * 2**20 + 1), "!!set {a}"]
)
def test_yaml_that_grows_is_refused(text):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match="."):
        bounded_yaml.load(text)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000


@pytest.mark.parametrize(
    ("content", "named"),
    [(b"<a>" * 100_000, "DEEPEST_GRAPH"), (b"<a>" + bytes(65 * 2**20), "LARGEST_GRAPH")],
)
def test_a_graph_that_grows_is_refused(content, named, tmp_path):
    (tmp_path / "000000.gexf").write_bytes(content)
    with pytest.raises(GraphError, match=named):
        read_gexf(tmp_path / "000000.gexf")
