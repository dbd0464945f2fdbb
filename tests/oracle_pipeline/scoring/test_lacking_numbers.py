"""A number that every normal recording has is part of what a robot says."""

import json

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from oracle_pipeline.bags.types import message_class
from oracle_pipeline.cli import main
from oracle_pipeline.scoring.comparable import given_numbers, lacking_numbers
from tests.oracle_pipeline.features.conftest import header, write_bag

JOINTS = ("pan", "lift", "wrist")
STATE = "sensor_msgs/msg/JointState"


def move(path, nth, joints=JOINTS):
    draw, recorded = np.random.default_rng(nth).normal, []
    for time_s in np.arange(0.0, 8.0, 0.05):
        angles = np.sin(time_s + nth + np.arange(len(joints))) + 0.01 * draw(size=len(joints))
        state = message_class(STATE)(
            header(time_s, ""), list(joints), angles, np.zeros(0), np.zeros(0)
        )
        recorded.append((time_s, "/joint_states", state))
    write_bag(path, recorded)
    return path


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    for nth in range(6):
        move(folder / "good" / f"{nth}", nth)
    card = folder / "arm.card"
    done = CliRunner().invoke(main, ["learn", str(folder / "good"), "--output", str(card)])
    assert done.exit_code == 0, done.output
    return card


@pytest.mark.parametrize(
    ("joints", "lacking"),
    [(JOINTS, ""), (JOINTS[:2], "position[wrist]"), (("pan", "lift", "hand"), "position[wrist]")],
)
def test_a_number_that_all_normal_recordings_have_is_missed(card, joints, lacking, tmp_path):
    recording = move(tmp_path / "tonight", 9, joints)
    words = ["score", str(recording), "--reference", str(card), "--far", "0.15"]
    done = CliRunner().invoke(main, [*words, "--format", "json"])
    (verdict,) = json.loads(done.stdout)["recordings"]
    said = [line for line in verdict["contract"] if " lacks " in line]
    told = f"Topic /joint_states lacks {lacking}, which all normal recordings have."
    assert said == ([told] if lacking else [])
    assert done.exit_code == int(bool(lacking))


def test_comparing_two_sets_tells_which_numbers_one_of_them_lacks(card, tmp_path):
    for nth in range(3):
        move(tmp_path / f"{nth}", nth, JOINTS[:2])
    done = CliRunner().invoke(main, ["compare", str(card.parent / "good"), str(tmp_path)])
    told = "B lacks position[wrist] of /joint_states, which all of the other set have."
    assert told in done.stdout
    assert "A lacks" not in done.stdout


def test_a_counter_that_moves_is_still_the_number_that_stood_still():
    still, moved = (
        pd.DataFrame([[0.0] * 3] * 9, columns=[f"signals./seen/{c}.missing" for c in columns])
        for columns in (("errors", "errors.rate", "x"), ("errors.rate", "x", "period"))
    )
    assert lacking_numbers(given_numbers(moved), given_numbers(still)) == {}


def test_a_sequence_of_messages_may_be_empty():
    columns = ["objects.length", "objects.pose.x", "speed"]
    seen = pd.DataFrame([[0.0] * 3] * 9, columns=[f"signals./seen/{c}.missing" for c in columns])
    none = seen.assign(**{"signals./seen/objects.pose.x.missing": np.nan})
    assert lacking_numbers(given_numbers(none), given_numbers(seen)) == {}
