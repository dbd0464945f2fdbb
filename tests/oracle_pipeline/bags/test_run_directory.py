import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RunDirectory, find_runs
from tests.locks import order_of_two


def stage(directory: RunDirectory, content: str = "{}") -> None:
    with directory.staged() as scratch:
        (scratch / "bag").mkdir()
        (scratch / "bag" / "bag_0.mcap").write_text(content)
        (scratch / MANIFEST_FILE).write_text(content)


def test_names_of_a_run(tmp_path):
    directory = RunDirectory(tmp_path, "fake_object", 3)
    assert (directory.run_id, directory.key) == ("run003", "fake_object|run003")
    assert directory.path == tmp_path / "runs" / "fake_object" / "run003"
    assert RunDirectory(tmp_path, "fake_object", 1234).run_id == "run1234"


@given(st.text())
def test_a_mode_cannot_lead_out_of_the_root(mode):
    try:
        directory = RunDirectory(Path("/root"), mode, 0)
    except RunDirectoryError:
        return
    assert directory.path.resolve() == Path("/root/runs", mode, "run000")


def test_bad_names_are_errors(tmp_path):
    with pytest.raises(RunDirectoryError, match=r"'\.\./evil'"):
        RunDirectory(tmp_path, "../evil", 0)
    with pytest.raises(RunDirectoryError, match="negative"):
        RunDirectory(tmp_path, "a", -1)


def test_a_staged_run_appears_only_when_it_is_complete(tmp_path):
    directory = RunDirectory(tmp_path, "a", 0)
    with directory.staged() as scratch:
        (scratch / MANIFEST_FILE).write_text("{}")
        assert not directory.is_complete()
        assert scratch.parent == directory.path.parent
        assert scratch.name.startswith(".")
        assert find_runs(tmp_path) == []
    assert directory.is_complete()
    assert [path.name for path in directory.path.parent.iterdir()] == ["run000"]


def test_a_run_that_fails_leaves_the_former_one(tmp_path):
    directory = RunDirectory(tmp_path, "a", 0)
    stage(directory, "former")
    with pytest.raises(TypeError), directory.staged() as scratch:
        (scratch / MANIFEST_FILE).write_text(b"not text")
    assert directory.manifest_path.read_text() == "former"
    assert [path.name for path in directory.path.parent.iterdir()] == ["run000"]


def test_a_new_run_takes_the_place_of_the_former_one(tmp_path):
    directory = RunDirectory(tmp_path, "a", 0)
    stage(directory, "former")
    (directory.path / "stale").touch()
    stage(directory, "new")
    assert directory.manifest_path.read_text() == "new"
    assert sorted(path.name for path in directory.path.iterdir()) == ["bag", MANIFEST_FILE]
    assert [path.name for path in directory.path.parent.iterdir()] == ["run000"]


def test_a_run_that_was_being_replaced_when_its_writer_died_is_not_lost(tmp_path):
    directory = RunDirectory(tmp_path, "a", 0)
    stage(directory, "former")
    directory.path.rename(directory.path.with_name(".run000.0badcafe"))  # and then: kill -9
    with pytest.raises(TypeError), directory.staged() as scratch:
        (scratch / MANIFEST_FILE).write_text(b"not text")
    assert directory.manifest_path.read_text() == "former"


def test_a_run_without_manifest_is_refused(tmp_path):
    directory = RunDirectory(tmp_path, "a", 0)
    without = pytest.raises(RunDirectoryError, match=r"a\|run000 was written without its manifest")
    with without, directory.staged():
        pass
    assert list(directory.path.parent.iterdir()) == []


def test_a_root_that_cannot_be_written_to_is_an_error(tmp_path):
    (tmp_path / "file").touch()
    directory = RunDirectory(tmp_path / "file", "a", 0)
    told = pytest.raises(RunDirectoryError, match=r"a\|run000 below .*file.*Choose a root")
    with told, directory.staged():
        pass


def test_find_runs_sees_complete_runs_in_order_and_nothing_else(tmp_path):
    for mode, run in (("b", 0), ("a", 10), ("a", 2)):
        stage(RunDirectory(tmp_path, mode, run))
    for other in ("a/run003", "a/.run004.abc", "a/other", "Bad-Mode/run000", "a/run5"):
        (tmp_path / "runs" / other).mkdir(parents=True)
    for other in ("a/.run004.abc", "a/other", "Bad-Mode/run000", "a/run5"):
        (tmp_path / "runs" / other / MANIFEST_FILE).touch()
    assert [run.key for run in find_runs(tmp_path)] == ["a|run002", "a|run010", "b|run000"]
    assert find_runs(tmp_path / "absent") == []


WRITER = """
    import sys, time
    from pathlib import Path
    from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RunDirectory

    while True:
        with RunDirectory(Path(sys.argv[1]), "a", 0).staged() as scratch:
            for number in range(20):
                (scratch / f"part{number}").write_text("x" * 1000)
            (scratch / MANIFEST_FILE).write_text("{}")
        print("done", flush=True)
"""


def start_writer(root: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", textwrap.dedent(WRITER), str(root)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def test_whenever_a_writer_is_killed_the_place_holds_a_complete_run_or_none(tmp_path):
    for number in range(4):
        with start_writer(tmp_path) as writer:
            writer.stdout.readline()
            time.sleep(0.004 * number)
            writer.send_signal(signal.SIGKILL)
        place = tmp_path / "runs" / "a" / "run000"
        assert not place.exists() or len(list(place.iterdir())) == 21
    stage(RunDirectory(tmp_path, "a", 0))
    assert [path.name for path in place.parent.iterdir()] == ["run000"]


def test_the_scratch_of_a_running_writer_is_not_removed(tmp_path):
    directory = RunDirectory(tmp_path, "a", 0)
    with directory.staged() as scratch:
        (scratch / MANIFEST_FILE).write_text("first")
        stage(directory, "second")
        assert (scratch / MANIFEST_FILE).read_text() == "first"
    assert directory.manifest_path.read_text() == "first"


def test_only_one_process_can_lock_a_run_and_no_lock_is_left(tmp_path):
    directory = RunDirectory(tmp_path, "a", 0)
    assert order_of_two(directory.held) == ["first", "second"]
    assert list(directory.path.parent.iterdir()) == []


def test_locking_a_run_restores_the_one_that_a_killed_writer_moved_aside(tmp_path):
    directory = RunDirectory(tmp_path, "a", 0)
    stage(directory, "former")
    directory.path.rename(directory.path.with_name(".run000.0badcafe"))  # and then: kill -9
    with directory.held():
        assert directory.manifest_path.read_text() == "former"


def test_a_path_gives_the_run_directory_that_it_is_of(tmp_path):
    directory = RunDirectory(tmp_path.resolve(), "fake_object", 3)
    assert RunDirectory.at(directory.path) == directory
    for other in (tmp_path, directory.bag, tmp_path / "fake_object" / "run003"):
        with pytest.raises(RunDirectoryError, match="is not the place of a run"):
            RunDirectory.at(other)
