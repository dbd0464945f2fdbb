import pytest

from oracle_pipeline.reporting.thesis_figures import FAMILIES, GRID, NO_FIGURE, PAIRWISE, RATES

DECODED = {  # false-positive rates, solved for by hand from the printed figures
    ("ward", "maxclust"): 0.957,
    ("single", "maxclust"): 0.956,
    ("ward", "distance"): 0.001,
    0.1: 0.949,
    0.3: 0.945,
    0.5: 0.944,
    0.7: 0.966,
    0.9: 0.959,
    "contextual": 0.955,
    "structural": 0.359,
    ("random_noise", "all"): 0.872,
    ("random_noise", "structural"): 0.066,
    ("fake_object", "all"): 1.0,
    ("fake_object", "structural"): 0.0,
    ("delayed_fakeobject", "all"): 0.934,
    ("delayed_fakeobject", "structural"): 0.0,
}
PRINTED = GRID | RATES | FAMILIES | PAIRWISE


@pytest.mark.parametrize("row", DECODED, ids=str)
def test_the_unpublished_false_positive_rates_are_decoded(row):
    assert PRINTED[row].fpr == pytest.approx(DECODED[row], abs=6e-4)


@pytest.mark.parametrize("row", PAIRWISE, ids=str)
def test_rows_of_fifteen_runs_decode_to_whole_runs(row):
    for rate in (PAIRWISE[row].recall, PAIRWISE[row].fpr):
        assert abs(rate * 15 - round(rate * 15)) / 15 < 0.0055


# Distinct runs of either class in the chosen cluster, and Matthews' correlation, by hand.
RUNS_AND_MCC = {
    ("ward", "maxclust"): (43, 43, 45, 0.00),
    ("complete", "maxclust"): (42, 43, 45, -0.05),
    ("single", "distance"): (1, 0, 45, 0.11),
    0.1: (42, 43, 45, -0.05),
    0.3: (43, 43, 45, 0.00),
    0.5: (42, 42, 45, 0.00),
    0.9: (44, 43, 45, 0.06),
    "structural": (35, 16, 45, 0.43),
    ("random_noise", "all"): (14, 13, 15, 0.11),
    ("random_noise", "structural"): (15, 1, 15, 0.94),
    ("fake_object", "all"): (14, 15, 15, -0.19),
    ("delayed_fakeobject", "structural"): (10, 0, 15, 0.71),
}


@pytest.mark.parametrize("row", RUNS_AND_MCC, ids=str)
def test_the_confusion_matrix_behind_a_row_is_decoded(row):
    malicious, others, runs, mcc = RUNS_AND_MCC[row]
    columns = PRINTED[row].columns()
    assert columns["thesis_runs"] == f"{malicious}/{runs} malicious, {others}/{runs} others"
    assert columns["thesis_mcc"] == pytest.approx(mcc, abs=5e-3)


def test_a_row_without_a_figure_has_the_same_columns():
    assert NO_FIGURE.keys() == GRID["ward", "maxclust"].columns().keys()
