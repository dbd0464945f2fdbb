import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.distance import pdist

from oracle_pipeline.clustering.grid_settings import GridSettings, in_metric
from oracle_pipeline.clustering.tree import ClusteringError
from oracle_pipeline.reporting.thesis_reports import bootstrapped_dataset, clustering_grid_search
from tests.oracle_pipeline.datasets.synthetic import run_features

rows = hnp.arrays(np.float64, (6, 4), elements=st.floats(-9.0, 9.0).map(lambda x: round(x, 2)))


@given(rows)
@pytest.mark.parametrize("metric", ["cosine", "correlation"])
def test_distances_in_a_metric_are_half_the_squares_of_those_of_its_rows(metric, X):
    centred = X - X.mean(axis=1, keepdims=True)
    X = X[(np.linalg.norm(X, axis=1) > 0.1) & (np.linalg.norm(centred, axis=1) > 0.1)]
    if len(X) > 1:
        squares = pdist(in_metric(X, metric)) ** 2 / 2.0
        assert squares == pytest.approx(pdist(X, metric), abs=1e-9)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"linkages": ("ward", "centre")}, "no linkage 'centre' .*; there are ward, single"),
        ({"metrics": ("manhattan",)}, "no metric 'manhattan' .* euclidean, cosine, correlation"),
        ({"select_by": "luck"}, "no measure 'luck'"),
    ],
)
def test_the_error_for_an_unknown_setting_lists_the_known_ones(settings, said):
    with pytest.raises(ClusteringError, match=said):
        GridSettings(**settings)


def test_the_grid_tries_each_setting_and_selects_by_the_measure():
    drawn = bootstrapped_dataset(run_features(runs=3, effect=3.0), 60).table
    grid = GridSettings(("ward", "average"), ("euclidean", "cosine"), (2.0, 3.0), "f1")
    report = clustering_grid_search(drawn, grid=grid)
    table = report.table
    assert len(table) == 2 * 2 * 2 * 2
    assert table["f1"].max() == report.summary["selected_value"]
    best = table.iloc[int(table["f1"].argmax())]
    assert report.summary["selected"].startswith(f"{best['linkage']}, {best['metric']}")
    precision = best["tp"] / (best["tp"] + best["fp"])
    recall = best["tp"] / (best["tp"] + best["fn"])
    assert best["f1"] == pytest.approx(2.0 * precision * recall / (precision + recall))
    assert best["accuracy"] == pytest.approx((best["tp"] + best["tn"]) / best["rows"])
