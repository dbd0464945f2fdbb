"""``oracle-sim record`` from a shell: its runs, its output and its errors."""

import resource
import subprocess
import sys

import pytest
from click.testing import CliRunner

from oracle_pipeline.bags.run_directory import RunDirectory, find_runs
from sim.commands.main import main
from tests.recorded_runs import copied

pytestmark = pytest.mark.slow


def oracle_sim(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-c", "from sim.commands.main import main; main()", *arguments],
        capture_output=True, text=True, check=False, **options,
    )  # fmt: skip


def record(*arguments):
    """The same in this process, to save the start of Python."""
    return CliRunner().invoke(main, ["record", *map(str, arguments)])


def test_the_command_records_a_run_once_and_prints_a_summary(tmp_path):
    arguments = ("-m", "fake_object", "-n", "1", "--goals", "1", "--out", str(tmp_path))
    first = oracle_sim("record", *arguments)
    assert first.returncode == 0, first.stderr
    assert "run000: succeeded, 1 of 1 goals" in first.stdout
    assert first.stderr == ""  # no progress bar without a terminal
    manifest = tmp_path / "runs" / "fake_object" / "run000" / "manifest.json"
    made_ns = manifest.stat().st_mtime_ns
    assert record(*arguments).stdout == first.stdout
    assert manifest.stat().st_mtime_ns == made_ns


def test_runs_of_several_modes_of_several_testbeds_are_recorded_at_once(tmp_path):
    done = record("-m", "cf_normal", "-m", "atc_normal", "--goals", 1, "--out", tmp_path)
    assert done.exit_code == 0, done.output
    assert {run.mode for run in find_runs(tmp_path)} == {"cf_normal", "atc_normal"}


def test_the_command_records_a_scenario_that_is_no_mode(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text(
        "schema: mutant/v1\nid: blind\nlabel: malicious\n"
        "main: {type: sensor_msgs/msg/LaserScan, input: /scan_tom, output: /scan_fakeobject}\n"
        "transform: {actions: [{name: blind, do: [{set: {field: ranges, value: inf}}]}]}\n"
    )
    arguments = ("--scenario", file, "--goals", 1, "--workers", 1, "--out", tmp_path)
    first = record(*arguments)
    assert first.exit_code == 0, first.output
    manifest = RunDirectory(tmp_path, "blind", 0).manifest()
    assert (manifest.mode, manifest.label, manifest.onset_s) == ("blind", "malicious", 0.0)
    assert {change.largest for change in manifest.changes} == {None}  # no return has no size
    file.write_text(file.read_text().replace("value: inf", "value: 1.0"))
    other = record(*arguments)
    assert other.exit_code == 1
    assert "another recipe (it differs in scenario)" in other.stderr


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ((), "either --mode or --scenario"),
        (("-m", "fake_object", "--scenario", "sensor_drop"), "either --mode or --scenario"),
        (("--scenario", "nothing.yaml"), "neither a scenario nor a file nothing.yaml"),
        (("--scenario", "command_injection"), "--allow-actuation"),
    ],
)
def test_invalid_options_are_refused_before_anything_is_recorded(tmp_path, options, text):
    result = record(*options, "--out", tmp_path)
    assert result.exit_code == 2
    assert text in " ".join(result.stderr.replace("│", " ").split())
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_mode_is_refused_with_the_existing_ones(tmp_path):
    result = record("-m", "fake", "--out", tmp_path)
    assert result.exit_code == 2
    assert "'fake' is not one of 'lidar_passthrough'" in result.stderr


def test_a_root_that_cannot_be_written_to_is_named(tmp_path):
    occupied = tmp_path / "occupied"
    occupied.write_text("a file")
    result = record("-m", "fake_object", "--goals", 1, "--workers", 1, "--out", occupied / "below")
    assert result.exit_code == 1
    assert str(occupied) in result.stderr
    assert isinstance(result.exception, SystemExit)  # and no traceback


def test_a_full_disk_fails_the_run_clearly_and_keeps_what_was_finished(recorded_run, tmp_path):
    copied(recorded_run("lidar_passthrough"), tmp_path)

    def no_file_over_a_megabyte():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))

    result = oracle_sim(
        "record", "-m", "lidar_passthrough", "-n", "2", "--goals", "1", "--workers", "1",
        "--out", str(tmp_path), preexec_fn=no_file_over_a_megabyte,
    )  # fmt: skip
    assert result.returncode == 1
    assert "lidar_passthrough|run001" in result.stderr
    assert "check free space" in result.stderr
    assert "Traceback" not in result.stderr
    assert [run.run for run in find_runs(tmp_path)] == [0]
