"""``oracle compare`` on real recordings: output and exit codes."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner, Result

from oracle_pipeline.cli import main
from tests.recorded_runs import RecordedRuns, linked


@pytest.fixture(scope="module")
def sets(recorded_run: RecordedRuns, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Roots of runs: two modes over six blocks, and two runs only."""
    root = tmp_path_factory.mktemp("sets")
    for mode in ("lidar_passthrough", "random_noise"):
        for run in range(6):
            linked(recorded_run(mode, run), root / mode)
    for run in range(2):
        linked(recorded_run("lidar_passthrough", run), root / "few")
    return {place.name: place for place in root.iterdir()}


def compare(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["compare", *map(str, arguments)])


@pytest.mark.slow(18)
def test_attacked_runs_differ_from_normal_ones_and_the_file_has_the_differences(
    sets: dict[str, Path], tmp_path: Path
) -> None:
    junit = tmp_path / "compare.xml"
    result = compare(
        sets["lidar_passthrough"], sets["random_noise"], "--format", "json", "--junit", junit
    )
    assert result.exit_code == 1, result.output
    document = json.loads(result.stdout)
    assert document["outcome"] == "different"
    assert document["pairs"] == 6  # same blocks: run with run
    families = {each["feature"].split(".")[0] for each in document["differences"]}
    assert {"pairs", "noise"} <= families  # the altered scans and those that they come from
    suite = ElementTree.fromstring(junit.read_bytes())  # noqa: S314 -- ours
    failed = {case.get("name") for case in suite if case.find("failure") is not None}
    assert failed == families
    assert int(suite.attrib["failures"]) == len(failed) < int(suite.attrib["tests"])


@pytest.mark.slow
def test_too_few_recordings_give_no_verdict_and_the_number_that_is_needed(
    sets: dict[str, Path],
) -> None:
    result = compare(sets["few"], sets["few"])
    assert result.exit_code == 2
    assert "Record 6 pairs" in result.stdout


def test_a_folder_without_recordings_is_an_error_with_its_name(tmp_path: Path) -> None:
    result = compare(tmp_path, tmp_path)
    assert result.exit_code == 2
    assert str(tmp_path) in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize("step", [1, -1], ids=["first", "second"])
def test_a_set_of_one_recording_is_refused_before_the_other_set_is_read(
    sets: dict[str, Path], tmp_path: Path, step: int
) -> None:
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).write_text("unreadable")
    one = next((sets["few"] / "runs/lidar_passthrough").iterdir())
    result = compare(*(one, tmp_path)[::step])
    assert result.exit_code == 2
    assert result.stderr == "Error: A set has 1 recording; each needs at least two.\n"
