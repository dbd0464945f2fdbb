"""The checks of the evaluation are reported with their results and values."""

from pathlib import Path

import dagster as dg
import pandas as pd
import pytest

from assets.evaluation_checks import CHECKS, EVALUATION, checks_of_evaluation
from oracle_pipeline.reporting.stored_report import Report
from resources.store import RunStore

pytestmark = pytest.mark.slow

STATUS = {"graphs_of_pairs_are_equal": "red", "hard_negatives_pass": "unsupported"}


def shown(root: Path) -> dg.ExecuteInProcessResult:
    job = dg.define_asset_job("checks", selection=dg.AssetSelection.all_asset_checks())
    store = RunStore(root=str(root))
    defs = dg.Definitions(
        asset_checks=[checks_of_evaluation], jobs=[job], resources={"store": store}
    )
    return defs.resolve_job_def("checks").execute_in_process(raise_on_error=False)


def test_red_fails_unsupported_warns_and_green_passes(tmp_path: Path) -> None:
    figures = {"figure": 0.5, "figure_low": 0.4, "figure_high": float("nan")}
    checks = [
        {"name": spec.name, "status": STATUS.get(spec.name, "green"), "sentence": spec.name}
        | figures
        for spec in CHECKS
    ]
    report = Report(pd.DataFrame(), {}, {"checks": pd.DataFrame(checks)})
    report.save(RunStore(root=str(tmp_path)).results(EVALUATION))
    found = {e.check_name: e for e in shown(tmp_path).get_asset_check_evaluations()}
    assert set(found) == {spec.name for spec in CHECKS}
    assert {name for name, e in found.items() if not e.passed} == set(STATUS)
    assert found["graphs_of_pairs_are_equal"].severity is dg.AssetCheckSeverity.ERROR
    assert found["hard_negatives_pass"].severity is dg.AssetCheckSeverity.WARN
    green = found["sessions_score_alike"]
    assert green.description == "sessions_score_alike"
    assert {name: value.value for name, value in green.metadata.items()} == {
        "status": "green", "figure": 0.5, "figure_low": 0.4
    }  # fmt: skip


def test_without_an_evaluation_the_error_states_the_remedy(tmp_path: Path) -> None:
    failure = shown(tmp_path).failure_data_for_node("checks_of_evaluation")
    assert failure is not None
    assert failure.user_failure_data is not None
    assert "has no report" in str(failure.user_failure_data.description)
