"""A run of the second testbed, which has neither goals nor a map, from recipe to features."""

from pathlib import Path

import pytest

from assets.worker.inspections import Inspection, inspect
from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RECORDED, TABLES, RunJob
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.datasets import feature_dataset, read_table
from sim.campaigns import Campaign

pytestmark = pytest.mark.slow

HALF_A_MINUTE = Campaign(timeout_s=30.0)


@pytest.mark.parametrize("mode", ["atc_normal", "atc_ghost_static"])
def test_an_air_traffic_run_becomes_all_five_assets_and_is_verified_then(
    mode: str, tmp_path: Path
) -> None:
    directory = RunDirectory(tmp_path, mode, 0)
    job = RunJob(directory, HALF_A_MINUTE, OF_A_RUN, refresh=False)
    report = process_run(job)
    assert report.simulated_s == 30.0
    assert report.assets.keys() == {*RECORDED, *TABLES}
    figures = report.assets["experiment_runs"].figures
    assert (figures["status"], figures["goals"], figures["contacts"]) == ("made", 0, 0)
    assert report.assets["interval_graphs"].figures["intervals"] == 3
    table = feature_dataset([read_table(tmp_path / report.assets["run_features"].path)])
    assert table["label"].tolist() == ["normal" if mode == "atc_normal" else "malicious"]
    looks = ("bag_is_complete", "every_interval_has_a_graph", "run_features_are_finite",
             "window_features_are_finite")  # fmt: skip
    assert [inspect(Inspection(name, (directory,))).wrong for name in looks] == [[]] * len(looks)
    again = process_run(job)
    assert again.simulated_s == 0.0
    assert again.assets["bags"].figures["status"] == "verified"
    assert again.assets["run_features"].version == report.assets["run_features"].version
