"""A run of the second testbed, which has neither goals nor a map, from recipe to features."""

from pathlib import Path

import pandas as pd
import pytest

from assets.worker.feature_tables import require_tables, require_trace
from assets.worker.inspections import Inspection, inspect
from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RECORDED, TABLES, RunJob
from oracle_pipeline.bags import layout
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.datasets import feature_dataset, read_table
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.oracles.traces import read_trace
from oracle_pipeline.robots.robot import find_robots
from sim.campaigns import Campaign
from tests.recorded_runs import linked

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


def test_features_and_signals_of_one_pass_equal_those_of_two(recorded_run, tmp_path: Path) -> None:
    run = linked(recorded_run("random_noise"), tmp_path)
    assert require_tables(run)
    kept = read_table(layout.traces(tmp_path) / run.mode / f"{run.run_id}.parquet")
    with open_run(run.path) as opened:
        (robot,) = find_robots(opened.bag)
        tables, alone = extract(opened, build_manager()), read_trace(robot)
    pd.testing.assert_frame_equal(kept, alone, check_exact=True)
    for table, other in (("run", tables.run), ("window", tables.windows)):
        of_both = read_table(run.feature_table(table))
        pd.testing.assert_frame_equal(of_both, other, check_exact=True, check_dtype=False)
    changed_ns = {path: path.stat().st_mtime_ns for path in layout.traces(tmp_path).rglob("*.*")}
    assert require_trace(run).equals(kept)
    assert {path: path.stat().st_mtime_ns for path in changed_ns} == changed_ns
