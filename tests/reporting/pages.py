"""The page of a synthetic campaign, made by the functions that make the real one."""

import io
import json
from functools import cache

import numpy as np
from PIL import Image

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.reporting import html, reports
from oracle_pipeline.reporting.evaluation import NO_GRID, oracle_evaluation
from oracle_pipeline.reporting.explanation import explanations
from tests.datasets.synthetic import campaign
from tests.evaluation.test_grid import grid_of
from tests.evaluation.thesis_runs import with_thesis_numbers

N = 60  # rows drawn


@cache
def picture() -> bytes:
    """Return a transparent picture, 300 px wide."""
    png = io.BytesIO()
    Image.new("RGBA", (480, 320), (117, 122, 131, 128)).save(png, "png")
    return png.getvalue()


def draw(run: str) -> bytes:
    """Return the picture of a run; one of them has no bag."""
    if run == "lidar_passthrough_odom|run000":
        raise OracleError(f"{run} has no bag.")
    return picture()


def page_of(df, windows, truth, *, differences=None, grid=NO_GRID, radar=None, **said):
    """Return the page of a campaign."""
    evaluation = oracle_evaluation(df, windows, truth, graph_differences=differences, grid=grid)
    drawn = reports.bootstrapped_dataset(df, N)
    return html.render(
        df,
        evaluation=evaluation,
        explained=explanations(df, windows, evaluation.tables["runs"], draw),
        grid=reports.clustering_grid_search(drawn.table),
        rates=reports.malicious_rate_report(df, N),
        pairs=reports.pairwise_report(df, N),
        side_by_side=reports.side_by_side(df, N),
        null_model=reports.null_model(3),
        radar=radar or {},
        provenance={**html.provenance(df), **said},
    )
