"""The assets over all runs read the tables on disk, and report if there are too few."""

import shutil
from dataclasses import replace

import dagster as dg
import pytest

from oracle_pipeline.datasets import read_table, write_table
from oracle_pipeline.reporting.stored_report import Report
from tests.assets.laboratory import ATTACKED, CONTROL, EVERYTHING, KEYS, PER_RUN, Laboratory
from tests.oracle_pipeline.evaluation.thesis_runs import thesis_runs

pytestmark = pytest.mark.slow(3)

AGGREGATES = [asset for asset in EVERYTHING if asset not in PER_RUN]


def test_the_dataset_has_every_existing_run(campaign: Laboratory) -> None:
    df = read_table(campaign.store.dataset("features"))
    assert list(df["run_id"]) == sorted(KEYS)
    figures = campaign.figures("feature_dataset")
    assert figures["runs_of_mode"] == {CONTROL: 2, ATTACKED: 2}
    assert (figures["runs"], figures["malicious_runs"]) == (4, 2)


def test_a_run_that_ended_before_its_onset_is_left_out_and_named(
    copy_of_campaign: Laboratory,
) -> None:
    run = copy_of_campaign.store.run(KEYS[0])
    replace(run.manifest(), onset_s=None).save(run.manifest_path)
    assert copy_of_campaign.materialize(["feature_dataset"]).success
    df = read_table(copy_of_campaign.store.dataset("features"))
    assert list(df["run_id"]) == sorted(KEYS[1:])
    assert copy_of_campaign.figures("feature_dataset")["left_out"] == KEYS[0]


@pytest.mark.parametrize("asset", AGGREGATES)
def test_an_aggregate_has_its_path_and_inputs(campaign: Laboratory, asset: str) -> None:
    materialization = campaign.latest(asset)
    assert materialization.partition is None
    assert isinstance(materialization.metadata["path"], dg.PathMetadataValue)
    assert (campaign.root / str(materialization.metadata["path"].value)).exists()
    assert len((materialization.tags or {})["dagster/data_version"]) == 64


def test_the_report_links_a_page_with_a_picture_for_each_run(campaign: Laboratory) -> None:
    page = campaign.store.report.read_text(encoding="utf-8")
    assert 'href="runs/index.html"' in page
    assert 'src="http' not in page
    for key in KEYS:
        of_run = campaign.store.run_pages / f"{key.replace('|', '/')}.html"
        assert 'src="data:image/png' in of_run.read_text(encoding="utf-8")
    assert campaign.figures("oracle_report")["url"] == "/oracle/report/"  # of the UI's own server


def test_reports_are_drawn_as_the_bootstrapped_dataset_was(copy_of_campaign: Laboratory) -> None:
    drawn = {"rows": 40, "malicious_rate": 0.5, "seed": 7}
    assert copy_of_campaign.materialize(
        ["bootstrapped_dataset", "pairwise_report"], config={"bootstrapped_dataset": drawn}
    ).success
    summary = Report.load(copy_of_campaign.store.results("pairwise_report")).summary
    assert {name: summary[name] for name in drawn} == drawn


def test_reports_follow_the_variant_by_which_rows_were_drawn(empty: Laboratory) -> None:
    write_table(thesis_runs(runs=3), empty.store.dataset("features"))
    assets = ["bootstrapped_dataset", "clustering_grid_search", "malicious_rate_report",
              "pairwise_report"]  # fmt: skip
    drawn = {"rows": 40, "variant": "thesis"}
    assert empty.materialize(assets, config={"bootstrapped_dataset": drawn}).success
    reports = [Report.load(empty.store.results(name)) for name in assets]
    assert [report.summary["variant"] for report in reports] == ["thesis"] * len(assets)
    assert len(reports[1].table) == 8  # the corrected variant has 16 settings
    assert "do not measure" in str(empty.figures("pairwise_report")["warning"])


def test_the_same_runs_give_the_same_versions(
    copy_of_campaign: Laboratory, campaign: Laboratory
) -> None:
    assert copy_of_campaign.materialize(AGGREGATES).success
    for asset in AGGREGATES:
        ours, theirs = copy_of_campaign.latest(asset).tags, campaign.latest(asset).tags
        assert ours is not None
        assert theirs is not None
        assert ours["dagster/data_version"] == theirs["dagster/data_version"]


def test_a_single_run_gives_a_report_with_notes(copy_of_campaign: Laboratory) -> None:
    features = copy_of_campaign.root / "features" / "run"
    shutil.rmtree(features / CONTROL)
    (features / ATTACKED / "run001.parquet").unlink()
    assert copy_of_campaign.materialize(AGGREGATES).success
    assert copy_of_campaign.figures("feature_dataset")["runs"] == 1
    assert "no normal runs" in copy_of_campaign.store.report.read_text(encoding="utf-8")


def test_without_runs_the_error_states_the_remedy(empty: Laboratory) -> None:
    result = empty.materialize(["feature_dataset"])
    failure = result.failure_data_for_node("feature_dataset")
    assert failure is not None
    assert failure.user_failure_data is not None
    assert "record runs" in str(failure.user_failure_data.description)
