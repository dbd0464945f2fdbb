"""Any files in the folder of scenarios: invalid ones are named, the others are modes."""

import os
import socket
import subprocess
import sys

import pytest

from sim.fuzzing.compilation import compile_file
from sim.fuzzing.scenario import MAX_BYTES, ScenarioError, load_scenarios
from sim.modes import FOLDER, left_out, modes

GOOD = """\
schema: mutant/v1
id: good
label: normal
main: {type: sensor_msgs/msg/LaserScan, input: /scan, output: /scan_fuzzed}
"""
FILES = {
    "aliases.yaml": b"a: &a [*a, *a]\n",
    "binary.yaml": bytes(range(256)) * 64,
    "bomb.yaml": b"".join(b"a%d: &a%d [*a%d, *a%d]\n" % (n, n, n - 1, n - 1) for n in range(1, 99)),
    "colour.yaml": GOOD.encode() + b'"\\e[31m\\udcff": 1\n',
    "deep.yaml": b"a: " + b"[" * 100_000,
    "deep_text.yaml": GOOD.encode()
    + b"transform: {timer: {do: [], period_s: '"
    + b"(" * 900
    + b"'}}",
    "empty.yaml": b"",
    "latin.yaml": GOOD.encode() + "title: Störung\n".encode("latin-1"),
    "list.yaml": b"- 1\n- 2\n",
    "nul.yaml": GOOD.encode() + b"title: a\0b\n",
    "number.yaml": GOOD.encode() + b"seed: " + b"9" * 4000 + b"\n",
    "tag.yaml": b"!!python/object/apply:os.system ['touch evaluated']\n",
    "utf16.yaml": GOOD.encode("utf-16"),
    "words.yaml": b"schema: mutant/v1\nid: null\nlabel: .nan\nmain: 2026-01-01\n",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """One valid scenario among invalid files."""
    monkeypatch.setenv(FOLDER, str(tmp_path))
    for name, content in FILES.items():
        (tmp_path / name).write_bytes(content)
    with (tmp_path / "huge.yaml").open("wb") as file:
        file.truncate(20 * 2**30)  # takes no room on disk, and no memory when it is read
    (tmp_path / "folder.yaml").mkdir()
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    (tmp_path / "nowhere.yml").symlink_to("/nowhere")
    (tmp_path / "device.yaml").symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket.yaml"))
    (tmp_path / os.fsdecode(b"\xff\x1b[2J.yaml")).write_text("a: 1\n")
    (tmp_path / "good.yaml").write_text(GOOD)
    return tmp_path


def test_every_file_that_is_no_scenario_has_a_diagnosis(folder):
    for file in folder.iterdir():
        if file.name == "good.yaml":
            assert list(compile_file(file))
        else:
            with pytest.raises(ScenarioError):
                list(compile_file(file))


def test_every_file_that_is_no_scenario_is_named_once_and_the_others_are_modes(folder):
    assert list(modes())[:1] == ["lidar_passthrough"]
    assert "good" in modes()
    others = {file.name for file in folder.iterdir()} - {"good.yaml"}
    broken = left_out()
    assert len(broken) == len(others)
    named = {name for name in others if any(f"{folder}/{name}" in text for text in broken)}
    assert others - named == {os.fsdecode(b"\xff\x1b[2J.yaml")}  # shown by codes


def test_their_errors_can_be_written_to_any_log_and_terminal(folder):
    for text in left_out():
        assert text.encode("utf-8")
        assert text.replace("\n", "").isprintable()


@pytest.mark.slow
def test_the_partitions_of_the_code_location_load(folder):
    code = "from assets.partitions import RUNS; print(RUNS.has_partition_key('good|run000'))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.strip() == "True", done.stderr
    assert "Left out" in done.stderr


def test_a_folder_that_cannot_be_listed_is_an_error(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv(FOLDER, str(tmp_path / "file"))
    assert "lidar_passthrough" in modes()
    (text,) = left_out()
    assert "which is no folder" in text


def test_a_file_is_read_up_to_the_limit_only(folder):
    with pytest.raises(ScenarioError, match=f"at most {MAX_BYTES} bytes, found more"):
        load_scenarios(folder / "huge.yaml")


def test_all_faults_of_a_file_are_reported_at_once(tmp_path):
    file = tmp_path / "faulty.yaml"
    file.write_text(GOOD.replace("normal", "odd").replace("/scan,", "scan,") + "more: 1\n")
    with pytest.raises(ScenarioError) as refusal:
        load_scenarios(file)
    lines = str(refusal.value).splitlines()
    assert [line.split(":")[1:3] for line in lines] == [
        ["5", "1"], ["3", "1"], ["4", "41"],
    ]  # fmt: skip
