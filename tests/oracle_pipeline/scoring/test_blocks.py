"""Recordings that share a start, a world or a number of one seed count once."""

import pytest

from oracle_pipeline import learn, score
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.robots.robot import find_robots
from oracle_pipeline.scoring.blocks import Origin, Start, blocks, origin_of
from tests.manifests import rewrite
from tests.oracle_pipeline.features.conftest import odometry, write_bag
from tests.recorded_runs import copied

HERE, THERE = Start(1.0, 2.0, 3.0, 0), Start(-1.0, 0.5, 0.0, 0)


@pytest.fixture
def origin(tmp_path):
    """Return the origin of a bag whose odometry starts somewhere, whatever its name."""

    def of(name, x, yaw, day=0, y=-0.5):
        times = (day * 86_400.0, day * 86_400.0 + 1.0)
        write_bag(tmp_path / name, [(t, "/odom", odometry(t, x, y, yaw, 0.4)) for t in times])
        with open_run(tmp_path / name) as run:
            (robot,) = find_robots(run.bag)
            return origin_of(run, robot, starts=True)

    return of


def test_nine_bags_of_three_starts_are_three_blocks(origin):
    names = iter("qwertzuio")
    found = blocks([origin(next(names), x, 3.1 + x / 100) for _ in range(3) for x in (1, 2, 3)])
    assert found[:3] == found[3:6] == found[6:]
    assert len(set(found)) == 3


def test_one_start_on_two_days_and_odometry_from_zero_tell_nothing(origin):
    assert len(set(blocks([origin("a", 1.0, 0.0), origin("b", 1.0, 0.0, day=3)]))) == 2
    assert origin("zero", 0.05, 0.05, y=0.0).start is None
    assert len(set(blocks([Origin(-1), Origin(-1)]))) == 2


def test_blocks_of_one_number_are_of_one_seed():
    runs = [Origin(seed, 3, f"house-{seed}", THERE) for seed in (7, 8)]
    assert blocks([*runs, runs[0]]) == [3, 1_000_003, 3]


def test_a_run_of_another_seed_is_not_of_a_block_of_the_card(normal_card, recorded_run, tmp_path):
    ours = recorded_run("fake_object")
    theirs = copied(ours, tmp_path)
    rewrite(theirs, lambda document: document.update(seed=document["seed"] + 1))
    found = score([ours.path, theirs.path], normal_card, far=0.2).verdicts
    assert [verdict.normal_blocks for verdict in found] == [4, 5]


def test_a_card_takes_seeds_of_any_size(recorded_run, tmp_path):
    runs = [copied(recorded_run("lidar_passthrough", number), tmp_path) for number in range(5)]
    for run in runs:
        rewrite(run, lambda document: document.update(seed=document["seed"] + 2**70))
    card = tmp_path / "large.card"
    learn([run.path for run in runs]).save(card)
    (found,) = score([runs[0].path], card, far=0.2).verdicts
    assert found.normal_blocks == 4


def test_a_drawn_world_or_a_start_in_one_world_is_one_block():
    drawn = [Origin(seed, seed, "house-5", start) for seed, start in ((7, HERE), (8, THERE))]
    fixed = [Origin(seed, seed, "hexagon-0", start) for seed, start in ((7, HERE), (8, THERE))]
    assert len(set(blocks(drawn))) == 1
    assert len(set(blocks(fixed))) == 2
    assert len(set(blocks([fixed[0], fixed[1]._replace(start=HERE)]))) == 1
    nowhere = [Origin(7, number, "airspace", None) for number in range(3)]
    assert blocks(nowhere) == [0, 1, 2]
