import functools
import json

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.reporting.stored_report import Report, ReportError
from oracle_pipeline.reporting.thesis_reports import (
    bootstrapped_dataset,
    clustering_grid_search,
    malicious_rate_report,
    pairwise_report,
    side_by_side,
)
from tests.oracle_pipeline.datasets.synthetic import run_features
from tests.oracle_pipeline.evaluation.thesis_runs import thesis_runs

pytestmark = pytest.mark.slow

N = 60


def of_thesis_s_method(variant="corrected"):
    """The four reports that can be made by either variant."""
    return {
        "bootstrapped": lambda df: bootstrapped_dataset(df, N, variant=variant),
        "grid": lambda df: clustering_grid_search(
            bootstrapped_dataset(df, N, variant=variant).table, variant=variant
        ),
        "rates": lambda df: malicious_rate_report(df, N, variant=variant),
        "pairs": lambda df: pairwise_report(df, N, variant=variant),
    }


REPORTS = of_thesis_s_method()
SMALL = run_features(runs=3)
FEATURES = [name for name in SMALL.columns if "." in name]
CAMPAIGNS = {
    "no attack": SMALL[SMALL["label"] == "normal"],
    "one run": SMALL.head(1),
    "constant": SMALL.assign(**dict.fromkeys(FEATURES, 1.0)),
    "one block, no graphs": run_features(runs=1)[[c for c in SMALL if "structural" not in c]],
    "nothing known": SMALL.assign(**dict.fromkeys(FEATURES, np.nan)),
}


@functools.cache
def of_small_campaign(name):
    return REPORTS[name](SMALL)


@functools.cache
def of_thesis_s_variant(name):
    return of_thesis_s_method("thesis")[name](thesis_runs(runs=3))


@pytest.mark.parametrize("campaign", CAMPAIGNS)
@pytest.mark.parametrize("name", REPORTS)
def test_every_campaign_gives_an_honest_report(campaign, name):
    report = REPORTS[name](CAMPAIGNS[campaign].reset_index(drop=True))
    assert_honest(report)


def assert_honest(report):
    assert len(report.table) > 0
    json.dumps(dict(report.summary), allow_nan=False)
    assert {type(value) for value in report.summary.values()} <= {float, int, str}
    if "auc" in report.table:
        unmeasured = report.table["auc"].isna()
        assert report.table.loc[unmeasured, "note"].astype(bool).all()


@pytest.mark.parametrize("name", ["bootstrapped", "rates"])
def test_a_report_is_a_function_of_its_input_and_survives_saving(name, tmp_path):
    report = of_small_campaign(name)
    report.save(tmp_path / name)
    REPORTS[name](SMALL).save(tmp_path / name)  # in place of the first
    back = Report.load(tmp_path / name)
    pd.testing.assert_frame_equal(back.table, report.table)
    assert back.summary == report.summary
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_folder_without_a_report_is_an_error(tmp_path):
    with pytest.raises(ReportError, match="has no report"):
        Report.load(tmp_path)


def test_the_grid_has_the_thesis_beside_it_once_for_each_of_its_rows():
    table = of_small_campaign("grid").table
    beside = table[table["thesis_source"] == "Table 5.1"]
    assert len(table) == 16
    assert len(beside) == 8
    ward = beside[(beside["linkage"] == "ward") & (beside["criterion"] == "maxclust")].iloc[0]
    assert (ward["t"], ward["thesis_recall"], ward["thesis_auc"]) == (2.0, 0.953, 0.498)
    assert ward["thesis_fpr"] == pytest.approx(0.957)


@pytest.mark.parametrize("name", of_thesis_s_method())
def test_the_thesis_s_variant_is_labelled_with_a_warning(name):
    report = of_thesis_s_variant(name)
    assert_honest(report)
    assert report.summary["variant"] == "thesis"
    assert "do not measure how well attacks are detected" in report.summary["warning"]
    assert of_small_campaign(name).summary["variant"] == "corrected"


def test_the_thesis_s_grid_has_its_eight_settings_only():
    table = of_thesis_s_variant("grid").table
    assert len(table) == 8
    assert set(zip(table["linkage"], table["t"], strict=True)) == {
        ("ward", 2.0), ("single", 4.0), ("complete", 4.0), ("average", 4.0),
    }  # fmt: skip
    assert (table["thesis_source"] == "Table 5.1").all()


def test_the_variants_use_different_features():
    runs = thesis_runs(runs=3)
    thesis_s = [name for name in runs if name.startswith("thesis.")]
    shuffled = runs.assign(**{name: runs[name].sample(frac=1).to_numpy() for name in thesis_s})
    ours, theirs = (of_thesis_s_method()["rates"](df).table for df in (runs, shuffled))
    pd.testing.assert_frame_equal(ours, theirs)
    of_ours, of_theirs = (
        of_thesis_s_method("thesis")["rates"](df).table for df in (runs, runs[runs.columns[::-1]])
    )
    pd.testing.assert_frame_equal(of_ours, of_theirs)


def test_runs_with_short_vectors_are_named():
    runs = thesis_runs(runs=3)
    runs.loc[4, "thesis.duration_ns"] = np.nan
    assert bootstrapped_dataset(runs, N, variant="thesis").summary["left_out"] == runs["run_id"][4]
    assert bootstrapped_dataset(runs, N).summary["left_out"] == ""


def test_runs_without_the_thesis_s_features_are_an_error_or_a_note():
    with pytest.raises(OracleError, match="extract the runs' features again"):
        of_thesis_s_method("thesis")["bootstrapped"](SMALL)
    table = of_thesis_s_method("thesis")["rates"](SMALL).table
    assert table["note"].str.contains("extract the runs' features again").all()


def test_each_printed_result_stands_beside_both_variants():
    report = side_by_side(thesis_runs(runs=4, effect=25.0), N)
    table = report.table
    assert_honest(report)
    assert table["thesis_source"].value_counts().to_dict() == {
        "Table 5.1": 8, "Table 6.1": 5, "Table 6.2": 6,
        "Section 6.2": 1, "Section 6.3": 1, "Section 6.4": 1,
    }  # fmt: skip
    rows = table.set_index("experiment")
    headline = rows.loc["all modes, all"]
    assert headline["thesis_runs"] == "43/45 malicious, 43/45 others"
    # Unscaled, duration drowns the attack that scaled features show.
    assert headline["corrected_auc"] > 0.95 > headline["reproduced_auc"]
    structural = rows.loc["all modes, structural"]
    assert (structural["reproduced_recall"], structural["reproduced_fpr"]) == (1.0, 0.0)
    assert structural["reproduced_recall_low"] < 1.0
    estimates = ("reproduced_recall", "reproduced_fpr", "reproduced_auc",
                 "corrected_tpr", "corrected_fpr", "corrected_auc")  # fmt: skip
    for name in estimates:
        assert (table[f"{name}_low"] <= table[name]).all()
        assert (table[name] <= table[f"{name}_high"]).all()


def test_rows_that_cannot_be_reproduced_have_the_reason():
    table = side_by_side(SMALL, N).table
    assert table["reproduced_auc"].isna().all()
    assert table["corrected_auc"].notna().all()
    assert table["note"].str.contains("extract the runs' features again").all()


def test_rates_and_pairs_are_those_of_the_thesis():
    rates, pairs = (of_small_campaign(name).table for name in ("rates", "pairs"))
    assert rates["malicious_rate"].tolist() == [0.1, 0.3, 0.5, 0.7, 0.9]
    assert rates["tp"].add(rates["fn"]).tolist() == [6, 18, 30, 42, 54]
    assert len(pairs) == 4 * 3
    assert (pairs["thesis_source"] != "").sum() == 3 + 6


@pytest.mark.parametrize("malicious", [True, False])
def test_a_campaign_of_one_class_is_drawn_from_that_class_with_a_note(malicious):
    campaign = run_features(runs=3)
    one_class = campaign[(campaign["label"] == "malicious") == malicious]
    report = bootstrapped_dataset(one_class, n=50)
    assert report.summary["malicious_rows"] == (50 if malicious else 0)
    assert report.summary["note"] == f"no {'normal' if malicious else 'malicious'} runs"
