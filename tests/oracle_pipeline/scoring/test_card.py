import json
import zipfile

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.features.signals.statistics import OF_RUN
from oracle_pipeline.robots.roles_file import RoleChoices
from oracle_pipeline.scoring.card import CardError, ReferenceCard, checked_card
from oracle_pipeline.scoring.feature_sets import ASPECTS
from oracle_pipeline.scoring.learning import learned_scorer
from tests.oracle_pipeline.scoring.test_contract import CONTRACT
from tests.oracle_pipeline.scoring.test_cross_conformal import ATTACKED, learned, runs

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def card():
    normal = runs(12, seed=0)
    aspects = {name: learned_scorer(normal, name) for name in ASPECTS}
    roles = RoleChoices(("/robot1",), {"odometry": ("/wheels",), "imu": ()})
    return ReferenceCard(learned(normal), normal.features, CONTRACT, ("a note",), aspects, roles)


@pytest.fixture
def file(card, tmp_path):
    card.save(tmp_path / "robot.card")
    return tmp_path / "robot.card"


def test_a_saved_and_loaded_card_gives_equal_scores(card, file):
    read, new = ReferenceCard.load(file), runs(6, seed=1, modes=ATTACKED, effect=2.0)
    scores = card.scorer.scores(new)
    np.testing.assert_array_equal(read.scorer.scores(new), scores)
    np.testing.assert_array_equal(read.scorer.p_values(scores), card.scorer.p_values(scores))
    windows = card.scorer.window_scores(new.windows)
    np.testing.assert_array_equal(read.scorer.window_scores(new.windows), windows)
    assert read.scorer.windows_.rule(4.0) == card.scorer.windows_.rule(4.0)
    assert list(read.aspects) == list(ASPECTS)
    for name, scorer in card.aspects.items():
        np.testing.assert_array_equal(read.aspects[name].scores(new), scorer.scores(new))
    pd.testing.assert_frame_equal(read.runs, card.runs)
    assert read.runs.attrs == card.runs.attrs
    assert read.contract == card.contract
    assert read.notes == card.notes
    assert read.roles == card.roles


def test_a_card_of_a_named_detector_gives_equal_scores_and_no_other_is_taken_for_it(tmp_path):
    normal, new = runs(12, seed=0), runs(6, seed=1, modes=ATTACKED, effect=2.0)
    scorer = learned_scorer(normal, detector="isolation_forest")
    ReferenceCard(scorer, normal.features).save(tmp_path / "robot.card")
    read = ReferenceCard.load(tmp_path / "robot.card").by_detector("isolation_forest")
    np.testing.assert_array_equal(read.scorer.scores(new), scorer.scores(new))
    with pytest.raises(CardError, match="with the detector isolation_forest, not with pca"):
        read.by_detector("pca")


def test_a_card_keeps_alarms_by_signals_and_one_of_an_earlier_release_has_those_by_features(
    tmp_path,
):
    normal, rng = runs(12, seed=0), np.random.default_rng(0)
    for table in (normal.features, normal.windows):
        for name in OF_RUN:
            table[f"signals./arm/elbow.{name}"] = rng.normal(size=len(table))
    scorer = learned_scorer(normal)
    for levels in ({"windows", "signal windows"}, {"windows"}):
        for fold in scorer.scorers_:
            fold.reach_ = {level: fold.reach_[level] for level in levels}
        ReferenceCard(scorer, normal.features).save(tmp_path / "robot.card")
        read = checked_card(tmp_path / "robot.card").scorer
        assert set(read.scorers_[0].reach_) == levels
        expected = scorer.window_scores(normal.windows)
        np.testing.assert_array_equal(read.window_scores(normal.windows), expected)


def test_the_same_card_gives_the_same_bytes(card, file, tmp_path):
    card.save(tmp_path / "again.card")
    assert (tmp_path / "again.card").read_bytes() == file.read_bytes()


def test_a_card_contains_only_json_and_parquet(file):
    with zipfile.ZipFile(file) as archive:
        kinds = {name: archive.read(name)[:4] for name in archive.namelist()}
    assert kinds.pop("card.json").startswith(b"{")
    assert set(kinds.values()) == {b"PAR1"}


def test_a_flipped_bit_is_an_error_or_changes_no_verdict(card, file):
    rng, whole = np.random.default_rng(0), file.read_bytes()
    new = runs(6, seed=1, modes=ATTACKED, effect=2.0)
    expected, noticed = card.scorer.scores(new), 0
    for position in rng.integers(len(whole), size=100).tolist():
        damaged = bytearray(whole)
        damaged[position] ^= 1 << int(rng.integers(8))
        file.write_bytes(bytes(damaged))
        try:
            read = checked_card(file)
        except CardError:
            noticed += 1
        else:
            np.testing.assert_array_equal(read.scorer.scores(new), expected)
    assert noticed > 70


def test_the_error_for_an_invalid_card_states_the_remedy(tmp_path):
    (tmp_path / "text.card").write_text("no card")
    for name in ("text.card", "absent.card"):
        with pytest.raises(CardError, match="oracle learn"):
            ReferenceCard.load(tmp_path / name)


@pytest.mark.parametrize("lacking", ["scorers", "contract", "notes", "breaching"])
def test_a_card_that_lacks_a_fact_is_an_error(file, lacking):
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    facts = json.loads(members["card.json"])
    del facts[lacking]
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in {**members, "card.json": json.dumps(facts).encode()}.items():
            archive.writestr(name, data)
    with pytest.raises(CardError, match=lacking):
        ReferenceCard.load(file)
