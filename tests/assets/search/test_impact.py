"""The sampler that changes the parameters with the largest impact."""

import optuna
import pytest

from assets.search.impact import ImpactSampler, impacts
from oracle_pipeline.reporting.searched import depends_on

FIRST = 20


def proposals(seed: int) -> list[dict[str, float | bool]]:
    """Return what is proposed for a robot that minds nothing but the second of four numbers."""

    def run(trial: optuna.Trial) -> tuple[float, float]:
        numbers = [trial.suggest_float(name, 0.0, 1.0) for name in "abcd"]
        if trial.suggest_categorical("sign", [False, True]):
            trial.suggest_float("of some only", 0.0, 1.0)
        return numbers[1], 0.0

    sampler = ImpactSampler(seed, FIRST)
    study = optuna.create_study(sampler=sampler, directions=["maximize", "minimize"])
    study.optimize(run, FIRST + 60)
    return [trial.params for trial in study.trials]


def test_what_matters_is_drawn_again_and_the_rest_is_kept_of_a_good_trial() -> None:
    drawn = dict.fromkeys("abcd", 0)
    all_ = proposals(7)
    for number, ours in enumerate(all_[FIRST:], FIRST):
        for name in drawn:
            drawn[name] += all(ours[name] != earlier[name] for earlier in all_[:number])
    assert drawn["b"] > 2 * max(drawn[name] for name in "acd")
    assert 60 < sum(drawn.values()) <= 2 * 60  # two of five or six parameters each time


def test_a_seed_gives_the_same_proposals() -> None:
    assert proposals(3) == proposals(3) != proposals(4)


def test_the_impact_is_the_share_of_the_variance_that_a_parameter_explains() -> None:
    given = [
        {"topic": "/odom", "s": 0.1 * n, "of some": 1}
        if n % 2
        else {"topic": "/scan", "s": 0.1 * n}
        for n in range(40)
    ]
    found = impacts(given, [3.0 if each["topic"] == "/odom" else 1.0 for each in given])
    assert found["topic"] == pytest.approx(1.0)
    assert found["s"] < 0.1
    assert found["of some"] == 0.0  # wherever it is given, the result is the same
    assert impacts([], []) == {}
    assert depends_on(found).startswith("topic (100%), s (")
