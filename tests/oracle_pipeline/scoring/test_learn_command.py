"""``oracle learn``: a reference card from recordings, and verdicts by it."""

import json
import re

import pytest
from click.testing import CliRunner

from oracle_pipeline.cli import main
from oracle_pipeline.scoring.judging import OTHER_ROLES
from tests.oracle_pipeline.features.conftest import drive, write_bag
from tests.oracle_pipeline.scoring.test_score_command import oracle_score, spinning

pytestmark = pytest.mark.slow

FAR = ("--far", 0.2)


def oracle_learn(*arguments: object, expect: int = 0):
    done = CliRunner().invoke(main, ["learn", *map(str, arguments)])
    assert done.exit_code == expect, done.output
    return done


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Four good bags and an anomalous one, which also has a topic that no good bag has."""
    root = tmp_path_factory.mktemp("recordings")
    for nth, name in enumerate("abcd"):
        write_bag(root / "good" / name, drive(nth))
    odd = [(t, f"/robot{topic}" if topic == "/odom" else topic, m) for t, topic, m in drive()]
    write_bag(root / "renamed", odd)
    write_bag(root / "spinning", spinning())
    return root


@pytest.fixture(scope="module")
def learned(place):
    return oracle_learn(place / "good", "--output", place / "robot.card")


def test_learning_describes_the_card_and_the_missing_blocks(learned):
    assert "Learned from 4 normal recordings: 4 blocks, 1 session." in learned.stdout
    assert "Contract: " in learned.stdout
    assert "rate of 0.2 or more; 5% needs 15 more blocks; 1% needs 95" in learned.stdout
    assert "taken as normal" in learned.stdout
    assert learned.stdout.rstrip().endswith("robot.card --far 0.2")


def test_learning_names_the_recording_that_is_unlike_the_others(place, learned, tmp_path):
    assert "Unlike the others" not in learned.stdout
    output = oracle_learn(
        place / "good", place / "spinning", "--output", tmp_path / "robot.card"
    ).stdout
    (odd,) = re.findall(r"Unlike the others: 1 recording\..*\n    (\S+): score", output)
    assert odd == str(place / "spinning")


def test_a_card_gives_the_verdicts_of_the_recordings_it_was_learned_from(place, learned):
    by_card, by_folder = (
        json.loads(
            oracle_score(
                place / "spinning", "--reference", place / name, *FAR, "--format", "json", expect=1
            ).stdout
        )["recordings"]
        for name in ("robot.card", "good")
    )
    assert by_card == by_folder


def test_recordings_are_scored_with_the_roles_that_the_card_was_learned_with(place, tmp_path):
    roles, others = tmp_path / "roles.yaml", tmp_path / "others.yaml"
    roles.write_text("roles: {odometry: []}")
    others.write_text("roles: {scan: [/scan]}")
    card = tmp_path / "robot.card"
    output = oracle_learn(place / "good", "--output", card, "--roles", roles).stdout
    assert "Roles file, used for scoring too: odometry none." in output

    def scored(*more: object) -> dict:
        done = CliRunner().invoke(
            main,
            ["score", *map(str, (place / "spinning", "--reference", card, *FAR, *more)),
             "--format", "json"],
        )  # fmt: skip
        (recording,) = json.loads(done.stdout)["recordings"]
        return recording

    by_card = scored()
    assert by_card == scored("--roles", roles)
    assert not any("total_turning" in each["feature"] for each in by_card["evidence"])
    assert OTHER_ROLES not in by_card["notes"]
    assert OTHER_ROLES in scored("--roles", others)["notes"]


def test_a_breach_of_the_contract_is_printed_before_the_statistics(place, learned):
    done = CliRunner().invoke(
        main,
        ["score", str(place / "renamed"), "--reference", str(place / "robot.card"), "--far", "0.2"],
    )
    lines = [line.strip() for line in done.stdout.splitlines()]
    assert lines[1:3] == [
        "Topic /odom is gone: every normal recording has it.",
        "Topic /robot/odom (nav_msgs/msg/Odometry) is new.",
    ]


def test_recordings_can_be_named_one_by_one(place, learned):
    names = [place / "good" / name for name in "abcd"]
    oracle_learn(*names, "--output", place / "again.card")
    assert (place / "again.card").read_bytes() == (place / "robot.card").read_bytes()


def test_too_few_recordings_are_refused_with_the_number_needed(place):
    done = oracle_learn(place / "good" / "a", "--output", place / "one.card", expect=2)
    assert "learning needs at least 3" in done.stderr
    assert not (place / "one.card").exists()


def test_a_card_needs_the_suffix_of_cards(place):
    done = oracle_learn(place / "good", "--output", place / "robot.zip", expect=2)
    assert "robot.zip.card" in done.stderr
