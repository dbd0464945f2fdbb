import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.datasets import DatasetError
from oracle_pipeline.evaluation.kill_rates import (
    MAGNITUDE,
    kill_matrix,
    kill_rates,
    minimum_detectable,
)
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


def mutants_by_hand(blocks):
    """Return 40 mutants, half of them killed by block, and four that changed nothing."""
    block = np.append(np.arange(40) % blocks, [0, 1, 2, 3])
    killed = block % 2 == 0
    messages = np.repeat([9, 0], [40, 4])
    same = {"split": "block", "scenario": "noise", "parameter": "level", "value": 1.0}
    return pd.DataFrame({"block": block, "killed": killed, "changed_messages": messages} | same)


def test_rates_leave_equivalent_mutants_out_and_their_intervals_count_blocks():
    rng = np.random.default_rng(0)
    alone, in_blocks = (
        kill_rates(mutants_by_hand(blocks), ["split"], rng).iloc[0] for blocks in (40, 4)
    )
    for row in (alone, in_blocks):
        counts = tuple(row[["mutants", "equivalent", "killed", "kill_rate"]])
        assert counts == (44, 4, 20, 0.5)
    width = alone["kill_rate_high"] - alone["kill_rate_low"]
    assert in_blocks["kill_rate_high"] - in_blocks["kill_rate_low"] > 1.5 * width


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


def rates_of(runs, grid):
    return kill_rates(kill_matrix(runs, grid, seed=0), MAGNITUDE, np.random.default_rng(0))


def test_stronger_attacks_are_killed_and_equivalent_mutants_do_not_count():
    kills = rates_of(runs_of_campaign(), grid_of([0.0, 40.0]))
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
    kills = rates_of(MeasuredRuns.ordered(features, windows), grid_of([10.0]))
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
