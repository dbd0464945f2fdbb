"""Samplers: all stay within bounds, and the guided one varies trials with rare changes."""

from typing import get_args

import numpy as np
import optuna
import pytest
from hypothesis import given
from hypothesis import strategies as st

from assets.search.samplers import MOVED, MessageGuidedSampler, Sampler, rarity, sampler_for

names = st.lists(st.lists(st.sampled_from("abcdef"), unique=True), max_size=8)


@given(names)
def test_rarities_of_all_trials_add_up_to_the_quantities_that_moved(moved: list[list[str]]) -> None:
    assert rarity(moved).sum() == pytest.approx(len({name for each in moved for name in each}))


@pytest.mark.parametrize("name", get_args(Sampler))
def test_a_sampler_with_the_same_seed_proposes_the_same_within_bounds(name: Sampler) -> None:
    proposed = []
    for _ in range(2):
        study = optuna.create_study(
            directions=["maximize", "minimize"], sampler=sampler_for(name, 3)
        )
        for _ in range(30):
            trial = study.ask()
            where = trial.suggest_categorical("topic", ["/scan", "/odom"])
            rate = trial.suggest_float(f"rate of {where}", 0.01, 10.0, log=True)
            count = trial.suggest_int("count", 2, 9)
            assert 0.01 <= rate <= 10.0
            assert 2 <= count <= 9
            trial.set_user_attr(MOVED, [where])
            study.tell(trial, [rate, count])
        proposed.append([trial.params for trial in study.trials])
    assert proposed[0] == proposed[1]


def test_trials_with_the_rarest_changes_are_varied_most() -> None:
    study = optuna.create_study(
        directions=["maximize", "minimize"], sampler=MessageGuidedSampler(1)
    )
    # All trials but one are equally good, and that one changed a feature that no other changed.
    for number in range(40):
        trial = study.ask({"rate": optuna.distributions.FloatDistribution(0.0, 1.0)})
        rare = number == 20
        trial.set_user_attr(MOVED, ["odometry"] * rare or ["scan"])
        study.tell(trial, [1.0, 1.0])
    special = study.trials[20].params["rate"]
    near = [abs(study.ask().suggest_float("rate", 0.0, 1.0) - special) < 0.2 for _ in range(200)]
    assert np.mean(near) > 0.5
