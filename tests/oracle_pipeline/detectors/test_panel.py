"""Laws that every member of the panel keeps, and a detector of an installed package."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone, is_outlier_detector

from oracle_pipeline.detectors import (
    DEFAULT_DETECTOR,
    DetectorError,
    named_detector,
    panel,
    pipeline,
)
from oracle_pipeline.detectors.panel import PLUGINS

pytestmark = pytest.mark.slow

MEMBERS = ("mahalanobis", "isolation_forest", "pca", "z_3", "z_10")
# No split sees what never varied in training (docs/explanation/detectors.md).
BLIND_TO_CONSTANTS = {"isolation_forest"}
PLUGGED = "boundary"  # scikit-learn's own class, named by an entry point
every_member = pytest.mark.parametrize("name", [*MEMBERS, PLUGGED])


def normal_runs(n=80, features=5, seed=0):
    return np.random.default_rng(seed).normal(size=(n, features))


def install(site, **points):
    """Install a package with detectors into a folder."""
    info = site / "more_detectors-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: more-detectors\nVersion: 1.0\n")
    lines = [f"{name} = {place}" for name, place in points.items()]
    (info / "entry_points.txt").write_text("\n".join([f"[{PLUGINS}]", *lines, ""]))
    return str(site)


@pytest.fixture(scope="module", autouse=True)
def plugged(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        site = tmp_path_factory.mktemp("site")
        patch.syspath_prepend(install(site, **{PLUGGED: "sklearn.svm:OneClassSVM"}))
        yield


@pytest.fixture(scope="module")
def fitted(plugged):
    return {name: detector.fit(normal_runs()) for name, detector in panel(seed=0).items()}


def test_the_panel_is_the_same_in_the_same_order_for_every_seed():
    assert tuple(panel(0)) == tuple(panel(1)) == (*MEMBERS, PLUGGED)
    assert DEFAULT_DETECTOR in MEMBERS
    assert {d.get_params()["random_state"] for d in panel(7).values() if "random_state" in
            d.get_params() and d.get_params()["random_state"] is not None} == {7}  # fmt: skip


@every_member
@settings(max_examples=5)
@given(seed=st.integers(0, 2**32), spread=st.floats(0.5, 20.0))
def test_a_score_does_not_depend_on_the_rows_scored_with_it(name, fitted, seed, spread):
    rng = np.random.default_rng(seed)
    rows = rng.normal(scale=spread, size=(6, 5))
    together = fitted[name].score_samples(rows)
    alone = [fitted[name].score_samples(row[None, :])[0] for row in rows]
    order = rng.permutation(len(rows))
    assert together.shape == (6,)
    assert np.allclose(together, alone, rtol=1e-6)
    assert np.allclose(fitted[name].score_samples(rows[order]), together[order], rtol=1e-6)


@every_member
def test_an_extreme_run_scores_lower_than_normal_ones(name, fitted):
    far_out = np.full((1, 5), 12.0)
    others = normal_runs(seed=1)
    assert fitted[name].score_samples(far_out)[0] < np.quantile(
        fitted[name].score_samples(others), 0.05
    )


@every_member
def test_fitting_again_gives_the_same_scores(name, fitted):
    rows = normal_runs(seed=2)
    again = clone(fitted[name])
    assert again.get_params() == fitted[name].get_params()
    assert not hasattr(again, "n_features_in_")
    assert np.array_equal(
        again.fit(normal_runs()).score_samples(rows), fitted[name].score_samples(rows)
    )


@every_member
def test_it_is_an_outlier_detector_with_its_number_of_features(name, fitted):
    assert is_outlier_detector(fitted[name])
    assert fitted[name].n_features_in_ == 5
    with pytest.raises(ValueError, match="4 features"):
        fitted[name].score_samples(np.zeros((1, 4)))


@pytest.mark.filterwarnings("ignore:The covariance matrix associated:UserWarning")
@every_member
def test_a_feature_constant_in_training_is_used_unless_documented_otherwise(name):
    constant = np.c_[normal_runs(), np.zeros(80)]
    detector = panel(0)[name].fit(constant)
    usual, odd = np.zeros((1, 6)), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 50.0]])
    seen = detector.score_samples(odd)[0] < detector.score_samples(usual)[0]
    assert seen == (name not in BLIND_TO_CONSTANTS)


@every_member
def test_it_works_behind_the_scaler(name):
    columns = [f"family.{letter}" for letter in "abcde"]
    df = pd.DataFrame(normal_runs(), columns=columns) * [1.0, 10.0, 1e3, 1e-3, 1.0] + 7.0
    oracle = pipeline(panel(0)[name], {"family.a": 0.01}).fit(df)
    assert oracle[0].floors == {"family.a": 0.01}
    assert np.isfinite(oracle.score_samples(df.iloc[:2])).all()


@pytest.mark.parametrize("place", ["no.such:thing", "sklearn.svm:SVC", "builtins:dict"])
def test_a_detector_that_cannot_score_is_named_with_its_package(place, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(install(tmp_path / "site", odd=place))
    with pytest.raises(DetectorError, match=rf"odd \({place}\).* uninstall its package"):
        panel(0)


def test_an_unknown_detector_is_refused_with_those_that_exist():
    with pytest.raises(DetectorError, match=f"no detector 'pac'; known are .*pca, .*{PLUGGED}"):
        named_detector("pac", 0)
