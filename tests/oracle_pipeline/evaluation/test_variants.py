import numpy as np
import pandas as pd
import pytest
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist
from sklearn.metrics import roc_auc_score

from oracle_pipeline.clustering.tree import CRITERIA, LINKAGES
from oracle_pipeline.datasets import DatasetError, feature_columns
from oracle_pipeline.evaluation.clustering_result import cluster_and_judge
from oracle_pipeline.evaluation.variants import CORRECTED, THESIS
from tests.oracle_pipeline.datasets.synthetic import run_features
from tests.oracle_pipeline.evaluation.thesis_runs import thesis_runs

RUNS = thesis_runs()
THRESHOLDS = {"ward": 2, "single": 4, "complete": 4, "average": 4}


def test_slices_of_the_vector_equal_the_thesis_s():
    slices = {name: THESIS.columns(RUNS, name) for name in ("all", "structural", "contextual")}
    assert [len(columns) for columns in slices.values()] == [10, 7, 2]
    assert slices["contextual"] == ["thesis.range_variance", "thesis.duration_ns"]
    assert slices["structural"][-1] == "thesis.variance"
    assert "thesis.yaw_variance" in slices["all"]


@pytest.mark.parametrize("features", ["all", "structural", "contextual"])
def test_the_corrected_variant_uses_no_thesis_features(features):
    columns = CORRECTED.columns(RUNS, features)
    assert columns
    assert not set(columns) & set(THESIS.columns(RUNS, "all"))


def test_rows_are_drawn_with_the_thesis_s_seeds():
    normal, malicious = (RUNS[(RUNS["label"] == label)] for label in ("normal", "malicious"))
    expected = [
        *normal.sample(n=700, random_state=50, replace=True)["run_id"],
        *malicious.sample(n=300, random_state=51, replace=True)["run_id"],
    ]
    assert THESIS.draw(RUNS, 1000, 0.3, 50)["run_id"].tolist() == expected


def test_the_thesis_variant_does_not_scale():
    matrix = THESIS.matrix(RUNS, THESIS.columns(RUNS, "all"))
    assert matrix[:, -1] == pytest.approx(1e9 * RUNS["contextual.duration"])
    shares = matrix.var(axis=0) / matrix.var(axis=0).sum()
    assert shares[-1] == pytest.approx(1.0, abs=1e-12)


def test_runs_with_a_short_vector_are_left_out():
    broken = RUNS.copy()
    broken.loc[3, "thesis.range_variance"] = np.nan
    assert THESIS.whole_runs(broken).index.tolist() == [i for i in RUNS.index if i != 3]
    assert len(CORRECTED.whole_runs(broken)) == len(RUNS)


@pytest.mark.parametrize(
    "without", [run_features(), RUNS.assign(**{"thesis.density": np.nan})], ids=["column", "value"]
)
def test_runs_without_the_thesis_s_features_are_an_error(without):
    with pytest.raises(DatasetError, match="extract the runs' features again"):
        THESIS.whole_runs(without)


def test_a_missing_class_cannot_be_drawn():
    with pytest.raises(DatasetError, match="no malicious run to draw 30 rows"):
        THESIS.draw(RUNS[RUNS["label"] == "normal"], 100, 0.3, 50)


def reimplemented_thesis_method(
    rows: pd.DataFrame, method: str, criterion: str
) -> tuple[float, float]:
    """The whole method: repeated rows, SciPy, the best of clusters 1 to t by label."""
    X = rows[feature_columns(rows, ["thesis"])].to_numpy()
    t = THRESHOLDS[method]
    clusters = fcluster(linkage(pdist(X), method), t=t, criterion=criterion)
    malicious = (rows["label"] == "malicious").to_numpy()
    recalls = [malicious[clusters == number].sum() / malicious.sum() for number in range(1, t + 1)]
    best = int(np.argmax(recalls))
    verdict = clusters == best + 1 if recalls[best] > 0 else np.zeros(len(rows), dtype=bool)
    return recalls[best], roc_auc_score(malicious, verdict)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("method", LINKAGES)
@pytest.mark.parametrize("criterion", CRITERIA)
def test_recall_and_auc_equal_a_reimplementation_of_the_method(method, criterion, seed):
    rows = THESIS.draw(thesis_runs(effect=0.5, seed=seed), 400, 0.3, 50)
    result = cluster_and_judge(
        rows, THESIS.columns(rows, "all"), np.random.default_rng(0), method, criterion,
        THRESHOLDS[method], THESIS,
    )  # fmt: skip
    recall, area = reimplemented_thesis_method(rows, method, criterion)
    assert result.recall_best_cluster.value == pytest.approx(recall)
    assert result.balanced_accuracy_best_cluster.value == pytest.approx(area)
    # The rate that the thesis does not print follows from the two.
    assert result.fpr_best_cluster.value == pytest.approx(recall + 1 - 2 * area)
