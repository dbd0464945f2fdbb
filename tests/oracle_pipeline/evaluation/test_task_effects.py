import json

import numpy as np
import pytest

from oracle_pipeline.bags.behaviour import UNITS
from oracle_pipeline.datasets import is_hard_negative
from oracle_pipeline.evaluation.aspects import aspects_table
from oracle_pipeline.evaluation.comparisons import comparisons
from oracle_pipeline.evaluation.held_out import HeldOutScores
from oracle_pipeline.evaluation.task_effects import LEAST, task_effects
from tests.oracle_pipeline.evaluation.campaigns import synthetic


def campaign(blocks=30, seed=0, metres=0.0, spread=0.2, conditions=None):
    """Runs that drive about ten metres; attacked runs drive `metres` more."""
    judged = synthetic(blocks)
    rng = np.random.default_rng(seed)
    driven = 10.0 + judged.block + rng.normal(0.0, spread, len(judged.features))
    driven += metres * judged.malicious
    judged.truth["behaviour"] = [json.dumps({"driven_m": value}) for value in driven]
    if conditions is not None:
        slow = judged.features["mode"] == "benign_noise"
        judged.truth["conditions"] = np.where(slow, conditions, "{}")
    return judged


def test_unaltered_runs_are_rarely_called_misbehaved_for_any_spread():
    for seed, spread in enumerate((0.01, 0.2, 3.0)):
        effects = task_effects(campaign(seed=seed, spread=spread))
        assert effects.known.all()
        assert effects.misbehaved.mean() <= 0.03
        assert effects.uncertainty["driven_m"] >= LEAST["driven_m"]


def test_many_quantities_do_not_increase_false_misbehaviour():
    judged = campaign(blocks=60)
    rng = np.random.default_rng(1)
    judged.truth["behaviour"] = [
        json.dumps(dict(zip(UNITS, rng.normal(0.0, 9.0, len(UNITS)), strict=True)))
        for _ in range(len(judged.features))
    ]
    effects = task_effects(judged)
    unaltered = ~judged.malicious & ~is_hard_negative(judged.features)
    assert 0.0 < effects.misbehaved[unaltered].mean() <= 0.011


@pytest.mark.parametrize(("metres", "found"), [(0.3, False), (3.0, True), (-3.0, True)])
def test_an_effect_beyond_the_spread_of_repeats_is_misbehaviour(metres, found):
    judged = campaign(metres=metres)
    effects = task_effects(judged)
    attacked = effects.misbehaved[judged.malicious].mean()
    assert attacked > 0.95 if found else attacked < 0.2
    difference = effects.differences["driven_m"][judged.malicious].median()
    assert difference == pytest.approx(metres, abs=0.1)


def test_an_exact_repetition_does_not_count_as_a_repeat():
    judged = campaign(spread=0.0)
    effects = task_effects(judged)
    assert np.isnan(effects.uncertainty["driven_m"])
    assert not effects.known.any()


def test_a_run_under_other_conditions_has_no_repeats():
    judged = campaign(conditions='{"speed": 0.6}')
    effects = task_effects(judged)
    slow = (judged.features["mode"] == "benign_noise").to_numpy()
    assert not effects.known[slow].any()
    assert effects.known[~slow].all()


def test_few_repeats_give_no_uncertainty_and_no_verdict():
    effects = task_effects(campaign(blocks=3))
    assert np.isnan(effects.uncertainty["driven_m"])
    assert not effects.known.any()
    assert not effects.misbehaved.any()


def test_each_ground_truth_is_compared_with_its_own_score():
    judged = campaign(metres=3.0)
    effects = task_effects(judged)
    right = HeldOutScores(effects.size, np.where(effects.misbehaved, 0.01, 0.5), 29)
    constant = HeldOutScores(np.zeros_like(effects.size), np.full_like(effects.size, 0.5), 29)
    scores = {"tampering": constant, "misbehaviour": right}
    rng = np.random.default_rng(0)
    compared = comparisons(judged.features)
    table = aspects_table(scores, judged, effects, compared, rng).set_index(["aspect", "scope"])
    assert table.loc[("misbehaviour", "all modes"), "auc"] == 1.0
    assert table.loc[("misbehaviour", "all modes"), "malicious"] == effects.misbehaved.sum()
    assert table.loc[("tampering", "all modes"), "auc"] == 0.5
    assert table.loc[("misbehaviour", "all modes"), "auc_within_modes"] == 1.0
    assert np.isnan(table.loc[("tampering", "all modes"), "auc_within_modes"])
    assert table.loc[("tampering", "all modes"), "malicious"] == judged.malicious.sum()
    mode = judged.features["mode"].to_numpy()
    assert effects.misbehaved[mode == "fake_object"].mean() > 0.95
    assert effects.misbehaved[mode == "lidar_passthrough"].mean() < 0.2


def test_within_modes_only_blocks_whose_unaltered_runs_are_usual_count():
    judged = campaign(metres=3.0)
    mode, odd = judged.features["mode"].to_numpy(), judged.block == 0
    driven = np.array([json.loads(text)["driven_m"] for text in judged.truth["behaviour"]])
    driven -= 3.0 * (judged.malicious & (judged.block <= 1))  # without an effect
    recoveries = np.where(odd & (mode == "lidar_passthrough"), 9.0, 0.0)
    judged.truth["behaviour"] = [
        json.dumps({"driven_m": way, "recoveries": number})
        for way, number in zip(driven, recoveries, strict=True)
    ]
    effects = task_effects(judged)
    assert (effects.calm == ~odd).all()
    unusual = effects.size + 99.0 * odd
    scores = {"misbehaviour": HeldOutScores(unusual, np.full_like(unusual, 0.5), 29)}
    rng = np.random.default_rng(0)
    table = aspects_table(scores, judged, effects, comparisons(judged.features), rng)
    assert table.set_index("scope").loc["all modes", "auc_within_modes"] == 1.0
