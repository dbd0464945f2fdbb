import numpy as np
import pandas as pd

from oracle_pipeline.evaluation.comparisons import ComparedRuns, comparisons, judge
from oracle_pipeline.evaluation.held_out import HeldOutScores
from tests.oracle_pipeline.evaluation.campaigns import synthetic


def judged(campaign, score, p, calibration=100, scope="all modes"):
    chosen = next(s for s in comparisons(campaign.features) if s.name == scope)
    scores = HeldOutScores(score, p, calibration)
    return judge(scores, campaign, chosen, np.random.default_rng(0))


def test_comparisons_are_pairs_shadows_the_real_obstacle_and_hard_negatives():
    df = synthetic(3).features
    named = {scope.name: set(df.loc[scope.runs, "mode"]) for scope in comparisons(df)}
    assert next(iter(named)) == "all modes"
    assert named["lidar_passthrough / random_noise"] == {"lidar_passthrough", "random_noise"}
    assert "random_noise_shadow / random_noise" in named
    assert named["benign_obstacle / fake_object"] == {"benign_obstacle", "fake_object"}
    assert named["hard negatives"] == {"benign_noise", "benign_obstacle"}
    six = df[~df["mode"].str.contains("shadow|benign")]
    assert len(comparisons(six)) == 4


def test_an_attack_without_a_partner_is_compared_with_all_normal_modes():
    df = synthetic(3).features
    found = df[df["mode"] == "random_noise"].assign(mode="range_drift_miss017")
    df = pd.concat([df, found], ignore_index=True)
    named = {scope.name: set(df.loc[scope.runs, "mode"]) for scope in comparisons(df)}
    normal = named["normal / range_drift_miss017"]
    assert {"lidar_passthrough", "range_drift_miss017"} <= normal
    assert not any("benign" in mode or "shadow" in mode for mode in normal)
    assert normal.isdisjoint({"random_noise", "fake_object"})
    assert "normal / random_noise" not in named


def test_metrics_equal_a_hand_calculation():
    campaign = synthetic(3)
    n = len(campaign.features)
    score = np.where(campaign.malicious, 2.0, 1.0)
    p = np.where(campaign.malicious, 0.01, 0.5)
    right = np.flatnonzero(~campaign.malicious)
    p[right[:3]] = 0.05
    row = judged(campaign, score, p)
    assert (row["malicious"], row["normal"], row["blocks"]) == (9, n - 9, 3)
    assert row["auc"] == row["detection_rate"] == 1.0
    assert row["false_positive_rate"] == 3 / (n - 9)
    assert row["false_positive_rate_low"] < 3 / (n - 9) < row["false_positive_rate_high"]
    assert "exit_detection_rate" not in row
    assert row["note"] == ""


def test_the_rates_of_the_exit_code_are_of_runs_with_a_verdict():
    campaign = synthetic(3)
    exits = np.where(campaign.malicious, 1.0, 0.0)
    exits[np.flatnonzero(~campaign.malicious)[:2]] = 1.0, np.nan
    everything = comparisons(campaign.features)[0]
    scores = HeldOutScores(exits, np.ones_like(exits), 100)
    row = judge(scores, campaign, everything, np.random.default_rng(0), exits=exits)
    assert (row["exit_detection_rate"], row["detection_rate"]) == (1.0, 0.0)
    assert row["exit_false_positive_rate"] == 1 / ((~campaign.malicious).sum() - 1)


def test_an_unsupported_rate_has_no_values():
    campaign = synthetic(3)
    score, p = np.zeros((2, len(campaign.features)))
    few = judged(campaign, score, p, calibration=18)
    assert np.isnan(few["detection_rate"])
    assert "18 calibration runs, 5% needs 19" in few["note"]


def test_a_scope_without_attacks_gives_false_alarms_alone():
    campaign = synthetic(3)
    p = np.full(len(campaign.features), 0.04)
    row = judged(campaign, np.zeros_like(p), p, scope="benign_noise")
    assert row["false_positive_rate"] == 1.0
    assert np.isnan([row["auc"], row["detection_rate"]]).all()
    assert row["note"] == "no malicious runs"


def test_a_row_without_scores_has_a_note():
    campaign = synthetic(3)
    nowhere = np.full(len(campaign.features), np.nan)
    row = judged(campaign, nowhere, nowhere)
    assert "no run could be scored" in row["note"]
    everything = ComparedRuns("all modes", np.ones(len(nowhere), dtype=bool))
    assert everything.runs.all()
