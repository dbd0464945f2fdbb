"""Processes that are killed at any moment, and two that want the same run at once."""

from pathlib import Path

from soak.faults import disturbed, leftovers, run_campaign, start, state

KILLS = 5


def test_a_campaign_killed_at_random_moments_ends_as_one_left_alone(tmp_path: Path) -> None:
    quiet, other = tmp_path / "quiet", tmp_path / "disturbed"
    undisturbed = start(quiet)
    wrong = list(disturbed(other, KILLS, seed=0))
    assert wrong == [[]] * (KILLS + 1)
    assert undisturbed.wait() == 0
    assert state(other) == state(quiet)
    assert leftovers(other) == []


def test_two_who_want_the_same_runs_at_once_make_each_once(tmp_path: Path) -> None:
    first, second = start(tmp_path), start(tmp_path)
    assert [first.wait(), second.wait()] == [0, 0]
    before = state(tmp_path)
    files = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    run_campaign(str(tmp_path))
    assert state(tmp_path) == before
    assert {path: path.stat().st_mtime_ns for path in files if path.is_file()} == {
        path: stamp for path, stamp in files.items() if path.is_file()
    }
    assert leftovers(tmp_path) == []
