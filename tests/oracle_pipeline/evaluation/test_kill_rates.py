import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.datasets import DatasetError
from oracle_pipeline.evaluation.kill_rates import kill_matrix, minimum_detectable, mutation_scores
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from tests.oracle_pipeline.datasets.synthetic import ATTACKED, MODES, campaign

pytestmark = pytest.mark.slow


def kills_by_hand(*rates, mutants=10):
    return pd.DataFrame(
        [
            {
                "split": "block", "scenario": "noise", "parameter": "level",
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
    """Runs of an attack that shifts two features by a number of deviations; 0 changes nothing."""
    runs, windows = [], []
    for shift in magnitudes:
        tables = campaign(blocks, shift, seed=7, modes={"random_noise": "malicious"})[:2]
        features, of_windows = (t.assign(run_id=f"{shift}/" + t["run_id"]) for t in tables)
        mutant = {"value": shift, "changed_messages": 100 * (shift > 0)}
        runs.append(features.assign(scenario="noise", parameter="level", **mutant))
        windows.append(of_windows)
    grid = pd.concat(runs, ignore_index=True)
    return MeasuredRuns.ordered(
        grid.assign(block=grid["block"] + used), pd.concat(windows, ignore_index=True)
    )


def runs_of_campaign(**more):
    return MeasuredRuns.ordered(*campaign(24, **more)[:2])


def test_stronger_attacks_are_killed_and_equivalent_mutants_do_not_count():
    kills = kill_matrix(runs_of_campaign(), grid_of([0.0, 40.0]), seed=0)
    unchanged, strong = (kills[kills["value"] == value] for value in (0.0, 40.0))
    assert (unchanged["equivalent"] == 4).all()
    assert unchanged["kill_rate"].isna().all()
    assert (strong["kill_rate"] == 1.0).all()


def test_an_attack_as_weak_as_a_hard_negative_is_detected_only_without_hard_negatives():
    features, windows, _ = campaign(24)
    for table in features, windows:
        harmless = table["mode"] == "benign_noise"
        for column, deviation in ATTACKED.items():
            table.loc[harmless, column] += 10.0 * deviation
    kills = kill_matrix(MeasuredRuns.ordered(features, windows), grid_of([10.0]), seed=0)
    rates = kills.set_index("split")["kill_rate"]
    assert rates["block"] < 0.5 < rates["block and hard negatives"]


def test_blocks_of_the_grid_are_not_used_for_training():
    runs, grid = runs_of_campaign(), grid_of([40.0], used=3)
    features = runs.features.copy()
    features.loc[features["block"].isin(grid.block), list(ATTACKED)] = 1e6
    odd = MeasuredRuns.ordered(features, runs.windows)
    pd.testing.assert_frame_equal(kill_matrix(odd, grid, 0), kill_matrix(runs, grid, 0))


def test_a_grid_without_its_index_is_an_error():
    with pytest.raises(DatasetError, match="lacks the columns scenario"):
        kill_matrix(runs_of_campaign(), runs_of_campaign(modes=MODES), 0)
