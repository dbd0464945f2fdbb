"""Pages of synthetic campaigns, made by the functions that make the real one."""

import io
import json
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
import pytest
from PIL import Image

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.evaluation import campaign_evaluation, metrics
from oracle_pipeline.evaluation.ranking import standing
from oracle_pipeline.reporting import html, thesis_reports
from oracle_pipeline.reporting.evaluation_report import evaluation_report
from oracle_pipeline.reporting.searched import searched
from oracle_pipeline.reporting.stored_report import Report
from tests.oracle_pipeline.datasets.synthetic import campaign
from tests.oracle_pipeline.evaluation.test_kill_rates import grid_of

ROWS = 60
QUICK = ("mahalanobis", "z_3")
UNDRAWN = "lidar_passthrough|run003"


@contextmanager
def quickly():
    """Two detectors, few resamples: slow parts have separate tests."""
    panel = campaign_evaluation.panel
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            campaign_evaluation, "panel", lambda seed: {name: panel(seed)[name] for name in QUICK}
        )
        patch.setattr(metrics, "RESAMPLES", 100)
        yield


def draw(run):
    """Return a transparent picture; one run has none."""
    if run == UNDRAWN:
        raise OracleError("its bag is gone")
    png = io.BytesIO()
    Image.new("RGBA", (480, 320), (117, 122, 131, 128)).save(png, "png")
    return png.getvalue()


def record(modes, blocks):
    """Return a placeholder for the command that records runs."""
    return f"record {' '.join(modes)} in {blocks} blocks"


def page_of(df, windows, truth, **more):
    """Return the page of a campaign; `more` as for `parts_of`."""
    return html.render(**parts_of(df, windows, truth, **more))


def parts_of(df, windows, truth, *, mutants=None, differences=None, **more):
    """Return what the page of a campaign shows; `more` is part of its provenance or forwarded."""
    passed_on = {name: more.pop(name) for name in ("storage", "searched") if name in more}
    with quickly():
        evaluation = campaign_evaluation.evaluate(
            df, windows, truth, graph_differences=differences, grid=mutants
        )
        judged = evaluation_report(evaluation)
        drawn = thesis_reports.bootstrapped_dataset(df, ROWS)
        return {
            "evaluation": judged,
            "record": record,
            "grid": thesis_reports.clustering_grid_search(drawn.table),
            "rates": thesis_reports.malicious_rate_report(df, ROWS),
            "pairs": thesis_reports.pairwise_report(df, ROWS),
            "side_by_side": thesis_reports.side_by_side(df, ROWS),
            "provenance": {**html.provenance(df), **more},
            **passed_on,
        }


def oracle_report_of(df, windows, truth):
    """Return the evaluation's report of a campaign."""
    with quickly():
        return evaluation_report(campaign_evaluation.evaluate(df, windows, truth))


def with_many_runs(report, runs=60):
    """Return an evaluation's report with `runs` runs of each mode and three more modes."""
    few = report.tables["runs"]
    of_mode = [rows for _, rows in few.groupby("mode", sort=False)]
    more = [of_mode[0].assign(mode=f"benign_{name}") for name in ("drop", "median", "slow")]
    drawn = [rows.sample(runs, replace=True, random_state=0) for rows in (*of_mode, *more)]
    numbered = [
        rows.assign(run_id=[f"{mode}|run{n:03d}" for n, mode in enumerate(rows["mode"])])
        for rows in drawn
    ]
    many = pd.concat(numbered, ignore_index=True)
    tables = {**report.tables, "runs": many, "standing": standing(many)}
    return Report(report.table, report.summary, tables)


def searches_of_two():
    """Return the section on a search that found a miss, and on one that found none."""
    passed = {"screened_out": False, "effect": 2.5, "score": 1.5, "passed": True}
    caught = {"screened_out": False, "effect": 8.0, "score": 90.0, "passed": False}
    given_up = {"screened_out": True, "effect": 0.0, "score": 70.0, "passed": False}
    with TemporaryDirectory() as name:
        for scenario, findings in (("drift", [passed, caught]), ("drop", [caught, given_up])):
            folder = Path(name) / "searches" / scenario
            folder.mkdir(parents=True)
            (folder / "findings.json").write_text(json.dumps({"far": 0.05, "findings": findings}))
            (folder / "front.png").write_bytes(draw(scenario))
        return searched(Path(name))


def write_pages(folder):
    """Write pages of synthetic campaigns: with every section, of 840 runs, and of two blocks.

    Two blocks support next to nothing, and one of their runs has no onset.
    """
    whole = parts_of(
        *campaign(30, effect=20.0),  # obvious attacks, and as many blocks as all checks need
        mutants=grid_of([1.0, 40.0], 2, used=30),
        differences=[],
        storage=pd.DataFrame({"mode": ["fake_object"], "full_bags": [9]}),
        searched=searches_of_two(),
        Note="<script>alert(1)</script>",
    )
    df, windows, truth = campaign(2)
    short = truth.iloc[:1].assign(run_id="delayed_fakeobject|run099", onset_s=float("nan"))
    pages = {
        "whole": html.render(**whole),
        "large": html.render(**{**whole, "evaluation": with_many_runs(whole["evaluation"])}),
        "poor": page_of(df, windows, pd.concat([truth, short], ignore_index=True)),
    }
    folder.mkdir()
    for name, page in pages.items():
        html.write_page(page, folder / f"{name}.html")
