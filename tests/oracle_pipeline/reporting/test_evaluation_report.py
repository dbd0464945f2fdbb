import functools
import json

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.evaluation import campaign_evaluation as evaluation
from oracle_pipeline.evaluation import metrics
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.reporting.evaluation_report import evaluation_report, in_words
from oracle_pipeline.reporting.stored_report import Report
from tests.oracle_pipeline.datasets.synthetic import CONTROLS, MODES, campaign, run_features
from tests.oracle_pipeline.evaluation.test_kill_rates import grid_of

pytestmark = pytest.mark.slow(2)


def oracle_evaluation(*tables, **options):
    return evaluation_report(evaluation.evaluate(*tables, **options))


QUICK = ("mahalanobis", "pca", "z_3")
FEW = {
    "lidar_passthrough": "normal",
    "random_noise": "malicious",
    "random_noise_shadow": "control",
    "benign_noise": "normal",
}


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    """Three detectors, few resamples: each has tests of its own."""
    panel = evaluation.panel
    monkeypatch.setattr(
        evaluation, "panel", lambda seed: {name: panel(seed)[name] for name in QUICK}
    )
    monkeypatch.setattr(metrics, "RESAMPLES", 200)


@functools.cache
def strong():
    steps = []
    report = oracle_evaluation(
        *campaign(24, effect=20.0, modes=FEW),
        graph_differences=[],
        grid=grid_of([1.0, 40.0], 2, used=24),
        progress=steps.append,
    )
    return report, steps


def test_the_headline_stands_first_with_its_intervals():
    report, steps = strong()
    first = report.table.iloc[0]
    assert tuple(first[["detector", "split", "scope"]]) == ("reference card", "block", "all modes")
    detected, false = (
        Estimate.of_row(first, f"exit_{name}") for name in ("detection_rate", "false_positive_rate")
    )
    assert detected.low > 0.85
    assert false.low <= 0.05
    assert report.summary["headline"] == in_words(detected, false)
    assert report.summary["exit_detection_rate"] == detected.value
    assert "By features alone" in report.summary["verdicts"]
    assert steps[0].startswith("reference card")


def test_there_is_a_row_for_every_split_and_scope_and_for_every_detector():
    table = strong()[0].table
    cards = table[table["detector"] == "reference card"]
    others = table[table["detector"] != "reference card"]
    assert set(cards["split"]) == {"block", "world", "block and hard negatives"}
    pairs = cards[cards["scope"] == "random_noise_shadow / random_noise"]
    assert (pairs[["malicious", "normal"]] == 24).all(axis=None)
    assert set(others["detector"]) == set(QUICK)
    assert set(others["scope"]) == {"all modes"}
    assert not table.duplicated(["detector", "split", "scope"]).any()


def test_the_other_tables_and_pictures_exist():
    report, _ = strong()
    assert set(report.tables) == {
        "alarms", "checks", "open_claims", "runs", "standing",
        "aspects", "task_uncertainty", "task_differences", "raised",
        "kills", "mutation_scores", "minimum_detectable",
    }  # fmt: skip
    assert report.tables["runs"]["p"].between(0, 1).all()
    assert set(report.tables["runs"]["exit"]) == {0.0, 1.0}
    alarms = report.tables["alarms"].iloc[0]
    assert alarms["time_to_detect_median_s"] <= 10.0


def test_without_verdicts_there_is_a_ranking_but_no_claim_of_a_rate():
    report = oracle_evaluation(*campaign(6, effect=20.0))
    assert report.summary["headline"].startswith("All 18 attacked runs score higher than all 48")
    claims = report.tables["open_claims"].set_index("claim")
    assert "graphs of pairs are equal" in claims.loc["All integrity checks", "reason"]
    assert np.isfinite(report.table["auc"].iloc[0])
    checked = report.tables["checks"].set_index("name")["status"]
    assert checked["graphs_of_pairs_are_equal"] == "unsupported"


def test_without_an_effect_there_is_no_finding():
    report = oracle_evaluation(*campaign(24, seed=1, modes=FEW), graph_differences=[])
    first = report.table.iloc[0]
    assert Estimate.of_row(first, "auc").covers(0.5)
    assert first["exit_detection_rate"] < 0.15
    assert first["exit_false_positive_rate_low"] <= 0.05


def test_a_red_check_withholds_the_headline():
    report = oracle_evaluation(
        *campaign(24, effect=20.0, modes=FEW),
        graph_differences=["random_noise|run000: node:/intruder"],
    )
    assert report.summary["headline"].startswith("All 24 attacked runs score higher")
    claims = report.tables["open_claims"]
    assert "A detection rate for other recordings than these" in set(claims["claim"])


@pytest.mark.parametrize(
    "cut",
    [
        lambda df: df[df["label"] == "normal"],
        lambda df: df[df["block"] == 0],
        lambda df: df.head(1),
        lambda df: df.assign(**dict.fromkeys([c for c in df if "." in c], np.nan)),
    ],
    ids=["no attack", "one block", "one run", "nothing known"],
)
def test_every_campaign_gives_an_honest_report(cut, tmp_path):
    features, windows, truth = campaign(3, modes=MODES | CONTROLS)
    kept = cut(features)
    kept.attrs["fields"] = features.attrs["fields"]
    report = oracle_evaluation(kept, windows, truth)
    assert "Exit code" not in report.summary["headline"]
    assert len(report.tables["open_claims"])
    assert report.table.loc[report.table["auc"].isna(), "note"].astype(bool).all()
    json.dumps(dict(report.summary), allow_nan=False)
    report.save(tmp_path / "report")
    assert set(Report.load(tmp_path / "report").tables) == set(report.tables)


def test_reports_survive_saving_with_and_without_further_tables(tmp_path):
    plain = Report(run_features(1), {"runs": 6})
    plain.save(tmp_path / "report")
    assert Report.load(tmp_path / "report").tables == {}
    Report(run_features(1), {}, {"more": run_features(2)}).save(tmp_path / "report")
    back = Report.load(tmp_path / "report")
    pd.testing.assert_frame_equal(back.tables["more"], run_features(2))


@pytest.mark.parametrize("name", ["summary.json", "table.parquet"])
def test_a_flipped_bit_in_a_report_is_an_error_or_changes_nothing(name, tmp_path):
    Report(run_features(1), {"headline": "No claim", "runs": 6}).save(tmp_path / "report")
    file = tmp_path / "report" / name
    content = file.read_bytes()
    for at in np.random.default_rng(15).choice(8 * len(content), 50, replace=False):
        flipped = bytearray(content)
        flipped[at // 8] ^= 1 << at % 8
        file.write_bytes(flipped)
        try:
            back = Report.load(tmp_path / "report")
        except OracleError:
            continue
        assert name == "summary.json"
        assert back.summary == {"headline": "No claim", "runs": 6}  # a bit of the seal's name


def test_a_campaign_of_two_modes_in_two_blocks_gives_a_report_without_rates():
    features, windows, truth = campaign(2, effect=20.0)
    few = features[features["mode"].isin(["lidar_passthrough", "random_noise"])]
    report = oracle_evaluation(few, windows, truth)
    assert np.isnan(report.table["auc"].iloc[0])
    assert report.summary["headline"].startswith("Nothing can be compared yet")
