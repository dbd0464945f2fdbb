import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.evaluation.campaign import CampaignError
from oracle_pipeline.evaluation.grid import kill_matrix, minimum_detectable, mutation_scores
from tests.datasets.synthetic import ATTACKED, CONTROLS, MODES, run_features

MODES_OF_GRID = MODES | CONTROLS


def kills_by_hand(*rates, mutants=10):
    return pd.DataFrame(
        [
            {
                "detector": "max_z", "features": "all", "scenario": "noise", "parameter": "level",
                "value": value, "mutants": mutants + 2, "equivalent": 2,
                "killed": round(rate * mutants), "kill_rate": rate,
            }
            for value, rate in rates
        ]
    )  # fmt: skip


def magnitude(*rates):
    row = minimum_detectable(kills_by_hand(*rates)).iloc[0]
    return row["magnitude_low"], row["magnitude"]


def test_the_detectable_magnitude_is_the_first_from_which_on_all_are_detected():
    assert magnitude((1, 0.2), (2, 0.9), (3, 1.0)) == (1, 2)
    assert magnitude((1, 0.9), (2, 0.8), (3, 1.0)) == (2, 3)
    assert magnitude((1, 1.0), (2, 1.0)) == (0, 1)
    assert np.isnan(magnitude((1, 1.0), (2, 0.8))).all()


def test_the_mutation_score_leaves_equivalent_mutants_out():
    row = mutation_scores(kills_by_hand((1, 0.2), (2, 1.0))).iloc[0]
    assert (row["mutants"], row["killed"], row["mutation_score"]) == (20, 12, 0.6)
    assert row["mutation_score_low"] < 0.6 < row["mutation_score_high"]


def grid_of(magnitudes, blocks=4, used=0):
    """Runs of an attack that shifts two features by so many deviations; 0 changes nothing."""
    parts = []
    for shift in magnitudes:
        runs = run_features(blocks, seed=7, modes={"random_noise": "malicious"})
        for column, deviation in ATTACKED.items():
            runs[column] += shift * deviation
        parts.append(
            runs.assign(
                scenario="noise", parameter="level", value=shift, changed_messages=100 * (shift > 0)
            )
        )
    grid = pd.concat(parts, ignore_index=True)
    return grid.assign(block=grid["block"] + used)


def test_stronger_attacks_are_killed_and_what_changes_nothing_counts_for_nothing():
    campaign = run_features(12, modes=MODES_OF_GRID)
    kills = kill_matrix(campaign, grid_of([0.0, 40.0]), seed=0)
    unchanged, strong = (kills[kills["value"] == value] for value in (0.0, 40.0))
    assert (unchanged["equivalent"] == 4).all()
    assert unchanged["kill_rate"].isna().all()
    assert (strong.loc[strong["detector"] == "mahalanobis", "kill_rate"].max()) == 1.0
    assert {"all", "structural", "contextual"} <= set(kills["features"])
    assert "max_z" in set(kills["detector"])


def test_runs_of_blocks_that_the_grid_uses_do_not_train():
    campaign, grid = run_features(12, modes=MODES_OF_GRID), grid_of([40.0], used=3)
    odd = campaign.copy()
    odd.loc[odd["block"].isin(grid["block"]), list(ATTACKED)] = 1e6
    pd.testing.assert_frame_equal(kill_matrix(odd, grid, 0), kill_matrix(campaign, grid, 0))


def test_a_grid_without_its_index_is_refused():
    with pytest.raises(CampaignError, match="lacks the columns scenario"):
        kill_matrix(run_features(12), run_features(3), 0)
