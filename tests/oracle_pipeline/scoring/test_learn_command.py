"""``oracle learn``: a reference card from recordings, and verdicts by it."""

import json
import re
from hashlib import sha256
from html import unescape
from importlib.metadata import version

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner

from oracle_pipeline.cli import main
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.contract_file import ContractError, contract_as_yaml, read_contract
from oracle_pipeline.scoring.likeness import LEAST
from oracle_pipeline.scoring.selection import LEAST_SCORE
from tests.oracle_pipeline.features.conftest import drive, write_bag
from tests.oracle_pipeline.robots.recordings import IMU, JOINTS, bag_with
from tests.oracle_pipeline.scoring.test_contract import CONTRACT
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
    (farthest,) = re.findall(r"Unlike the others: \d recordings?\..*\n    (\S+): score", output)
    assert farthest == str(place / "spinning")


def test_recordings_of_one_sensor_that_differ_by_noise_are_not_unlike_each_other(tmp_path):
    rng, time_s = np.random.default_rng(0), np.arange(150) * 0.1
    for number in range(40):
        log = pd.DataFrame({"time": time_s, "temperature": rng.normal(20.0, 0.1, 150)})
        log.to_csv(tmp_path / f"{number:02d}.csv", index=False)
    output = oracle_learn(tmp_path, "--output", tmp_path / "sensor.card").stdout
    assert max(map(float, re.findall(r": score ([\d.]+)", output)), default=0.0) < LEAST_SCORE
    assert "set aside" not in output


@pytest.mark.parametrize("chosen", [(), ("--detector", "pca")], ids=["ours", "pca"])
def test_a_card_gives_the_verdicts_of_the_recordings_it_was_learned_from(place, chosen, tmp_path):
    card = tmp_path / "robot.card"
    oracle_learn(place / "good", "--output", card, *chosen)
    by_card, by_folder = (
        json.loads(
            oracle_score(
                place / "spinning", "--reference", reference, *FAR, *chosen, "--format", "json",
                expect=1,
            ).stdout
        )["recordings"]
        for reference in (card, place / "good")
    )  # fmt: skip
    (of_file,), (of_folder,) = (
        [each.pop("card") for each in shown] for shown in (by_card, by_folder)
    )
    assert of_file["sha256"] == sha256(card.read_bytes()).hexdigest()
    assert of_folder is None
    assert by_card == by_folder
    assert by_card[0]["evidence"][0]["feature"].startswith("signals.") == bool(chosen)


def test_recordings_are_scored_with_the_roles_that_the_card_was_learned_with(place, tmp_path):
    roles = tmp_path / "roles.yaml"
    roles.write_text("roles: {odometry: []}")
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


def test_a_topic_takes_the_role_of_another_only_by_a_roles_file(place, learned, tmp_path):
    arguments = (place / "renamed", "--reference", place / "robot.card", *FAR, "--format", "json")
    (recording,) = json.loads(oracle_score(*arguments, expect=1).stdout)["recordings"]
    (caution,) = recording["cautions"]
    assert "odometry (in the reference /odom; here perhaps /robot/odom)" in caution
    assert "features of the reference count as usual" in " ".join(recording["notes"])
    roles = tmp_path / "roles.yaml"
    roles.write_text(caution[caution.index("{") :])
    done = oracle_score(*arguments, "--roles", roles, expect=2)
    (by_roles,) = json.loads(done.stdout)["recordings"]
    assert by_roles["cautions"] == by_roles["contract"] == []
    # Under its usual name it is one of the recordings that the card was learned from.
    assert by_roles["notes"][0].startswith("Its block is part of the reference")


def test_another_robot_is_another_system_without_a_p_value(place, learned, tmp_path):
    other = bag_with(tmp_path / "arm", {"/imu/data": IMU, "/joint_states": JOINTS})
    reference = ("--reference", place / "robot.card", *FAR)
    files = ("--junit", tmp_path / "it.xml", "--page", tmp_path / "it.html")
    done = oracle_score(other, *reference, *files, "--format", "json", expect=2)
    (recording,) = json.loads(done.stdout)["recordings"]
    assert recording["outcome"] == "another system"
    assert recording["p_value"] is None
    assert 0.0 <= recording["in_common"] < LEAST
    differences = recording["differences"]
    assert 1 <= len(differences) <= 5
    text = oracle_score(other, *reference, expect=2).stdout
    assert text.startswith("ANOTHER SYSTEM")
    assert "1 of another system in" in text
    junit, page = ((tmp_path / name).read_text() for name in ("it.xml", "it.html"))
    assert "<error " in junit
    card = recording["card"]
    assert card["release"] == version("ros2-behaviour-oracle")
    for shown in (text, unescape(junit), unescape(page)):
        assert f"SHA-256 {card['sha256'][:16]}, learned {card['learned']} by" in shown
        assert recording["summary"] in shown
        assert all(each in shown for each in differences)


def test_a_breach_of_the_contract_is_printed_before_the_statistics(place, learned):
    done = CliRunner().invoke(
        main,
        ["score", str(place / "renamed"), "--reference", str(place / "robot.card"), "--far", "0.2"],
    )
    lines = [line.strip() for line in done.stdout.splitlines()]
    assert lines[3:5] == [
        "Topic /odom is gone: every normal recording has it.",
        "Topic /robot/odom (nav_msgs/msg/Odometry) is new.",
    ]


def test_a_contract_can_be_shown_edited_and_used(place, tmp_path):
    card, file = tmp_path / "robot.card", tmp_path / "contract.yaml"
    oracle_learn(place / "good", "--output", card, "--contract", file)
    shown = CliRunner().invoke(main, ["card", "show", str(card)]).stdout
    assert f"SHA-256 {sha256(card.read_bytes()).hexdigest()[:16]}" in shown
    for part in ("4 blocks", "rate of 0.2 or more", "odometry: /odom", "nav_msgs/msg/Odometry"):
        assert part in shown
    printed = CliRunner().invoke(main, ["card", "show", str(card), "--contract"]).stdout
    assert printed == file.read_text()
    assert read_contract(file) == ReferenceCard.load(card).contract
    call = (place / "renamed", "--reference", card, *FAR, "--format", "json", "--contract", file)
    (before,) = json.loads(oracle_score(*call, expect=1).stdout)["recordings"]
    gone = "Topic /odom is gone: every normal recording has it."
    assert gone in before["contract"]
    edited = yaml.safe_load(printed)
    edited["topics"]["/odom"]["always"] = False
    file.write_text(yaml.safe_dump(edited))
    done = CliRunner().invoke(main, ["score", *map(str, call)])
    assert gone not in json.loads(done.stdout)["recordings"][0]["contract"]


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda text: text.replace("always: true", "always: often", 1), r"always: 'often' is not"),
        (lambda text: text.replace("paces:", "pace:"), "'paces' is a required property"),
        (lambda text: text + "extra: 1\n", "it has extra; known are topics"),
        (lambda _: "a: &x 1\nb: *x\n", "alias"),
        (lambda _: "[", "not a contract"),
    ],
)
def test_an_invalid_contract_is_refused_with_its_place(change, fault, tmp_path):
    file = tmp_path / "contract.yaml"
    file.write_text(change(contract_as_yaml(CONTRACT)))
    with pytest.raises(ContractError, match=fault):
        read_contract(file)


def test_recordings_can_be_named_one_by_one(place, learned):
    names = [place / "good" / name for name in "abcd"]
    oracle_learn(*names, "--output", place / "again.card")
    assert (place / "again.card").read_bytes() == (place / "robot.card").read_bytes()


def test_too_few_recordings_are_refused_with_the_number_needed(place):
    done = oracle_learn(place / "good" / "a", "--output", place / "one.card", expect=2)
    assert "count as 1 block; learning needs at least 3" in done.stderr
    assert "1 reference recording without a label: taken as normal." in done.stderr
    assert not (place / "one.card").exists()


def test_a_card_needs_the_suffix_of_cards(place):
    done = oracle_learn(place / "good", "--output", place / "robot.zip", expect=2)
    assert "robot.zip.card" in done.stderr
