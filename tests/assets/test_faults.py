"""Processes that are killed at any moment, and two that want the same run at once."""

from pathlib import Path

from assets.worker import process_run
from sim.fan_out import fan_out, process_pool
from soak.faults import disturbed, jobs, leftovers, start, state

KILLS = 5


def test_a_campaign_killed_at_random_moments_ends_as_one_left_alone(tmp_path: Path) -> None:
    quiet, other = tmp_path / "quiet", tmp_path / "disturbed"
    undisturbed = start(quiet)
    wrong = list(disturbed(other, KILLS, seed=0))
    assert wrong == [[]] * (KILLS + 1)
    assert undisturbed.wait() == 0
    assert state(other) == state(quiet)
    assert leftovers(other) == []


def test_of_two_who_want_the_same_run_at_once_one_makes_it(tmp_path: Path) -> None:
    job = jobs(tmp_path)[0]
    outcomes = list(fan_out(process_run, [job, job], lambda: process_pool(2)))
    statuses = [o.result.assets["bags"].figures["status"] for o in outcomes if o.result]
    assert sorted(statuses) == ["made", "verified"]
    assert leftovers(tmp_path) == []
