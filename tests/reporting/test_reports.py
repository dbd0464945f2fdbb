import functools
import json

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.reporting.reports import (
    bootstrapped_dataset,
    clustering_grid_search,
    headline,
    malicious_rate_report,
    oracle_evaluation,
    pairwise_report,
)
from oracle_pipeline.reporting.result import Report, ReportError
from oracle_pipeline.reporting.tables import estimate
from tests.datasets.synthetic import run_features

N = 60
REPORTS = {
    "bootstrapped": lambda df: bootstrapped_dataset(df, N),
    "grid": lambda df: clustering_grid_search(bootstrapped_dataset(df, N).table),
    "rates": lambda df: malicious_rate_report(df, N),
    "pairs": lambda df: pairwise_report(df, N),
    "evaluation": oracle_evaluation,
}
SMALL = run_features(runs=3)
FEATURES = [name for name in SMALL.columns if "." in name]
CAMPAIGNS = {
    "no attack": SMALL[SMALL["label"] == "normal"],
    "one run": SMALL.head(1),
    "constant": SMALL.assign(**dict.fromkeys(FEATURES, 1.0)),
    "one block, no graphs": run_features(runs=1)[[c for c in SMALL if "structural" not in c]],
    "nothing known": SMALL.assign(**dict.fromkeys(FEATURES, np.nan)),
}
REFUSED = {"nothing known": {"grid"}}  # what has no honest table at all


@functools.cache
def of_small_campaign(name):
    return REPORTS[name](SMALL)


@pytest.mark.parametrize("campaign", CAMPAIGNS)
@pytest.mark.parametrize("name", REPORTS)
def test_every_campaign_gives_an_honest_report_or_a_clear_refusal(campaign, name):
    df = CAMPAIGNS[campaign].reset_index(drop=True)
    if name in REFUSED.get(campaign, ()):
        with pytest.raises(OracleError, match=r"no (normal|malicious) run|Cannot cluster"):
            REPORTS[name](df)
        return
    report = REPORTS[name](df)
    assert len(report.table) > 0
    assert all(png.startswith(b"\x89PNG") for png in report.figures.values())
    json.dumps(dict(report.summary), allow_nan=False)
    assert {type(value) for value in report.summary.values()} <= {float, int, str}
    if "auc" in report.table:
        unmeasured = report.table["auc"].isna()
        assert report.table.loc[unmeasured, "note"].astype(bool).all()


@pytest.mark.parametrize("name", ["bootstrapped", "evaluation"])
def test_a_report_is_a_function_of_its_input_and_comes_back_from_its_folder(name, tmp_path):
    report = of_small_campaign(name)
    report.save(tmp_path / name)
    REPORTS[name](SMALL).save(tmp_path / name)  # in place of the first
    back = Report.load(tmp_path / name)
    pd.testing.assert_frame_equal(back.table, report.table)
    assert (back.figures, back.summary) == (report.figures, report.summary)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_folder_without_a_report_is_refused(tmp_path):
    with pytest.raises(ReportError, match="holds no report"):
        Report.load(tmp_path)


def test_the_grid_has_the_thesis_beside_it_once_for_each_of_its_rows():
    table = of_small_campaign("grid").table
    beside = table[table["thesis_source"] == "Table 5.1"]
    assert len(table) == 16
    assert len(beside) == 8
    ward = beside[(beside["linkage"] == "ward") & (beside["criterion"] == "maxclust")].iloc[0]
    assert (ward["t"], ward["thesis_recall"], ward["thesis_auc"]) == (2.0, 0.953, 0.498)
    assert ward["thesis_fpr"] == pytest.approx(0.957)


def test_rates_and_pairs_are_those_of_the_thesis():
    rates, pairs = (of_small_campaign(name).table for name in ("rates", "pairs"))
    assert rates["malicious_rate"].tolist() == [0.1, 0.3, 0.5, 0.7, 0.9]
    assert rates["tp"].add(rates["fn"]).tolist() == [6, 18, 30, 42, 54]
    assert len(pairs) == 4 * 3
    assert (pairs["thesis_source"] != "").sum() == 3 + 6


def test_a_strong_attack_stands_out_in_the_evaluation():
    table = oracle_evaluation(run_features(runs=8, effect=25.0)).table
    area = estimate(table.iloc[0], "auc")
    assert area.low > 0.85
    assert headline(area).startswith("Attacked runs stand out clearly: AUC")


@pytest.mark.parametrize(
    ("area", "said"),
    [
        (Estimate(0.5, 0.3, 0.7), "cannot be told apart"),
        (Estimate(0.2, 0.1, 0.3), "below chance"),
        (Estimate(0.8, 0.6, 0.9), "not reliably"),
        (Estimate(np.nan, np.nan, np.nan), "Nothing could be measured"),
    ],
)
def test_the_headline_says_no_more_than_the_interval(area, said):
    assert said in headline(area)


@pytest.mark.parametrize("malicious", [True, False])
def test_a_campaign_of_one_class_is_drawn_from_that_class_and_says_so(malicious):
    campaign = run_features(runs=3)
    one_class = campaign[(campaign["label"] == "malicious") == malicious]
    report = bootstrapped_dataset(one_class, n=50)
    assert report.summary["malicious_rows"] == (50 if malicious else 0)
    assert report.summary["note"] == f"no {'normal' if malicious else 'malicious'} runs"
