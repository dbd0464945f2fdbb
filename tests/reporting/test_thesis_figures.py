import pytest

from oracle_pipeline.reporting.thesis_figures import FAMILIES, GRID, PAIRWISE, RATES

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
def test_the_false_alarms_that_the_thesis_does_not_print_are_decoded(row):
    assert PRINTED[row].fpr == pytest.approx(DECODED[row], abs=6e-4)


@pytest.mark.parametrize("row", PAIRWISE, ids=str)
def test_rows_of_fifteen_runs_decode_to_whole_runs(row):
    for rate in (PAIRWISE[row].recall, PAIRWISE[row].fpr):
        assert abs(rate * 15 - round(rate * 15)) / 15 < 0.0055
