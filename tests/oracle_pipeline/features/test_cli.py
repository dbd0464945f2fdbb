import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from oracle_pipeline.cli import main
from oracle_pipeline.datasets import read_table
from tests.oracle_pipeline.features.conftest import drive, write_bag

ORACLE = Path(sys.executable).with_name("oracle")


def oracle(*arguments: object):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_features_of_a_run_are_json(make_run):
    done = oracle("features", make_run().path)
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    (row,) = document["rows"]
    assert row["run_id"] == "fake_object|run003"
    assert row["contextual.duration"] == pytest.approx(23.0)
    assert "contextual.duration" not in row["missing"]
    assert document["fields"]["contextual.duration"]["unit"] == "s"


def test_features_of_any_bag_are_json_with_reasons(foreign_bag):
    done = oracle("features", foreign_bag, "--table", "window")
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)["rows"]
    assert [row["window_start_s"] for row in rows[:3]] == [0.0, 2.5, 5.0]
    assert rows[0]["structural.density"] is None
    assert "no ROS graph" in rows[0]["missing"]["structural.density"]


def test_text_has_a_line_for_each_feature_and_the_reasons_for_the_rest(foreign_bag):
    done = oracle("features", foreign_bag, "--format", "text")
    assert done.exit_code == 0, done.output
    row = json.loads(oracle("features", foreign_bag).stdout)["rows"][0]
    features = [name for name in row if "." in name and not name.startswith("signals.")]
    computed = [name for name in features if row[name] is not None]
    first, header, *lines = done.stdout.splitlines()
    assert first.startswith(f"{row['run_id']}: {len(computed)} of {len(features)} features, ")
    assert header.split() == ["feature", "value", "unit", "where"]
    assert [line.split()[0] for line in lines[: len(computed)]] == computed
    assert f"    structural.*      12  {row['missing']['structural.density']}" in lines


def test_text_on_windows_has_the_smallest_median_and_largest_value(foreign_bag):
    done = oracle("features", foreign_bag, "--table", "window", "--format", "text")
    rows = json.loads(oracle("features", foreign_bag, "--table", "window").stdout)["rows"]
    rates = sorted(row["generic.message_rate"] for row in rows)
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("generic.message_rate"))
    _, smallest, median, largest, unit = line.split()
    assert (smallest, largest, unit) == (f"{rates[0]:.4g}", f"{rates[-1]:.4g}", "1/s")
    assert rates[0] <= float(median) <= rates[-1]


@pytest.mark.slow
def test_a_terminal_gets_only_plain_text(foreign_bag):
    ours, theirs = pty.openpty()
    with subprocess.Popen([ORACLE, "features", foreign_bag], stdout=theirs) as child:
        os.close(theirs)
        with os.fdopen(ours, "rb", buffering=0) as terminal, contextlib.suppress(OSError):
            shown = terminal.read(4096)
            while terminal.read(4096):  # until the other end is closed, which is an error on Linux
                pass
    assert b" signals\r\nfeature " in shown
    assert child.returncode == 0


@pytest.mark.parametrize("table", ["run", "window"])
def test_parquet_goes_to_a_file(table, make_run, tmp_path):
    target = tmp_path / "features.parquet"
    options = ("--table", table, "--format", "parquet")
    done = oracle("features", make_run().path, *options, "--output", target)
    assert done.exit_code == 0, done.output
    assert done.output == ""
    assert len(read_table(target)) == (1 if table == "run" else 10)
    done = oracle("features", make_run().path, *options)
    assert done.exit_code == 2
    assert "--output" in done.stderr


def test_features_of_a_bag_need_no_library_that_takes_long_to_import(foreign_bag):
    heavy = {"pandas", "pyarrow", "networkx", "scipy.ndimage", "scipy.sparse", "tqdm"}
    code = f"""
import sys
from oracle_pipeline.cli import main
main(["features", sys.argv[1]], standalone_mode=False)
sys.exit(", ".join({heavy} & sys.modules.keys()))
"""
    done = subprocess.run(
        [sys.executable, "-c", code, foreign_bag], capture_output=True, text=True, check=False
    )
    assert done.stderr.strip() == ""
    assert json.loads(done.stdout)["rows"]


@pytest.mark.parametrize("program", [ORACLE, ORACLE.with_name("oracle-sim")], ids=["", "sim"])
def test_a_reader_that_has_seen_enough_is_no_failure(make_run, program):
    words = ["features", make_run().path] if program == ORACLE else ["scenario", "list"]
    done = subprocess.Popen([program, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    done.stdout.close()  # as `| head` does
    assert done.stderr.read() == b""
    assert done.wait() == 128 + signal.SIGPIPE


def test_json_can_go_to_a_file(make_run, tmp_path):
    assert oracle("features", make_run().path, "--output", tmp_path / "f.json").exit_code == 0
    assert json.loads((tmp_path / "f.json").read_text())["rows"]


def test_plugins_of_a_folder_are_used(make_run, tmp_path):
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "size.py").write_text(
        "from plugin_interface import FeatureExtractionPlugin\n"
        "class Size(FeatureExtractionPlugin):\n"
        "    def extract_features(self, G, cur):\n"
        "        return [len(G)]\n"
    )
    done = oracle("features", make_run().path, "--plugins", tmp_path / "plugins")
    assert json.loads(done.stdout)["rows"][0]["thesis.size_0"] == 8


def test_every_failure_is_one_line_and_exit_code_2(tmp_path, make_run):
    corrupt = make_run()
    (corrupt.bag / "bag_0.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "empty").mkdir()
    for arguments, text in (
        ((tmp_path / "absent",), "There is no bag"),
        ((tmp_path / "empty",), "is not a bag"),
        ((corrupt.path,), "is damaged: bag/bag_0.mcap"),
        ((corrupt.bag,), "no message could be read"),
        ((tmp_path, "--plugins", tmp_path / "none"), "no plugin folder"),
    ):
        done = oracle("features", *arguments)
        assert done.exit_code == 2
        assert text in done.stderr
        assert done.stderr.startswith("Error: ")
        assert done.stderr.count("\n") == 1
        assert done.stdout == ""
    blocked = ("--format", "json", "--output", tmp_path / "absent" / "file.json")
    done = oracle("features", make_run(run=4).path, *blocked)
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert oracle("features").exit_code == 2
    assert oracle("features", tmp_path, "--format", "csv").exit_code == 2


def test_a_defect_of_ours_ends_with_exit_code_2_too(make_run, monkeypatch):
    monkeypatch.setattr("oracle_pipeline.cli._json", lambda *_: 1 / 0)
    done = oracle("features", make_run().path)
    assert done.exit_code == 2
    assert "ZeroDivisionError" in done.stderr


@pytest.mark.slow
def test_the_installed_command_works(make_run):
    command = [ORACLE, "features", make_run().path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["rows"]


def test_help_has_an_example():
    assert "oracle features data/runs/" in oracle("features", "--help").output
    assert "features" in oracle("--help").output


def test_a_recording_whose_name_is_no_utf8_has_features(tmp_path):
    write_bag(tmp_path / "bag", drive())
    odd = (tmp_path / "bag").rename(tmp_path / os.fsdecode(b"night\xff\x1b"))
    done = CliRunner().invoke(main, ["features", str(odd)])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["rows"][0]["run_id"] == r"night\udcff\x1b"


@pytest.mark.slow
def test_several_recordings_are_rows_and_a_broken_one_is_left_out(tmp_path):
    for name in ("a", "b"):
        write_bag(tmp_path / name / "bag", drive())
    (tmp_path / "broken.mcap").write_bytes(b"no bag")
    paths = [str(tmp_path / name) for name in ("a/bag", "broken.mcap", "b/bag")]
    done = CliRunner().invoke(main, ["features", *paths])
    assert done.exit_code == 2
    assert "broken.mcap" in done.stderr
    rows = json.loads(done.stdout)["rows"]
    assert [row.pop("run_id") for row in rows] == [paths[0], paths[2]]
    (alone,) = json.loads(CliRunner().invoke(main, ["features", paths[0]]).stdout)["rows"]
    assert alone.pop("run_id") == "bag"
    assert [row.pop("block") for row in rows] == [-1, -3]  # so a reference counts each by itself
    assert alone.pop("block") == -1
    assert rows == [alone, alone]
