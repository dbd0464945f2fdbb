import numpy as np
import pytest

from oracle_pipeline.evaluation.variants import THESIS
from tools.bench.null_model import best_cluster_rates, label_free_runs


@pytest.fixture(scope="module")
def rates():
    return best_cluster_rates(0.05, repetitions=50, seed=0)


def test_without_a_signal_the_thesis_s_method_reaches_its_headline(rates):
    medians = rates.median()
    assert 0.90 <= medians["recall"] <= 1.0
    assert 0.47 <= medians["auc"] <= 0.53
    assert medians["fpr"] == pytest.approx(medians["recall"], abs=0.03)


def test_without_very_long_runs_duration_does_not_dominate(rates):
    alike = best_cluster_rates(0.0, repetitions=20, seed=0).median()
    assert alike["recall"] < 0.85 < rates["recall"].median()
    assert 0.45 <= alike["auc"] <= 0.55


def test_an_experiment_is_a_function_of_its_seed(rates):
    assert best_cluster_rates(0.05, 3, seed=0).equals(rates.head(3))
    assert not best_cluster_rates(0.05, 3, seed=1).equals(rates.head(3))


def test_there_are_as_many_runs_as_in_the_thesis_and_their_duration_dominates():
    df = label_free_runs(0.05, np.random.default_rng(0))
    assert df["label"].value_counts().to_dict() == {"normal": 45, "malicious": 45}
    assert df["run_id"].is_unique
    variances = THESIS.matrix(df, THESIS.columns(df, "all")).var(axis=0)
    assert variances[:-1].sum() < 1e-15 * variances[-1]
    assert df["thesis.duration_ns"].median() == pytest.approx(210e9, rel=0.15)
