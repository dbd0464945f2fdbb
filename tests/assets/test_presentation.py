"""Metadata for the UI: plain Python values, small pictures, readable tables."""

import base64

import dagster as dg
import numpy as np
import pandas as pd
import pytest

from assets import presentation
from oracle_pipeline.reporting.stored_report import Report

pytestmark = pytest.mark.slow

TABLE = pd.DataFrame(
    {
        "mode": ["a", "b"],
        "auc": [0.75, np.nan],
        "auc_low": [0.5, np.nan],
        "auc_high": [1.0, np.nan],
        "mcc": [0.123456, np.nan],
        "runs": [1, 2],
    }
)
TABLE.attrs["fields"] = {"mcc": {"unit": "1", "description": "Matthews correlation"}}


def test_a_picture_is_shown_if_it_is_small() -> None:
    assert presentation.picture(b"x" * presentation.MAX_PNG_BYTES) == {}
    shown = presentation.picture(b"small")["picture"].value
    assert isinstance(shown, str)
    assert base64.b64encode(b"small").decode() in shown


def test_a_report_is_facts_and_a_table() -> None:
    shown = presentation.report(
        Report(TABLE, {"runs": 2, "auc": 0.5, "note": "few", "left_out": ""})
    )
    assert "left_out" not in shown
    assert (shown["runs"], shown["auc"], shown["note"]) == (
        dg.MetadataValue.int(2),
        dg.MetadataValue.float(0.5),
        dg.MetadataValue.text("few"),
    )


def test_a_picture_among_facts_shows_inline() -> None:
    shown = presentation.facts({"runs": 2, "picture": b"small"})
    assert shown["picture"] == presentation.png(b"small")
    assert shown["runs"] == dg.MetadataValue.int(2)


def test_estimates_keep_their_intervals_and_gaps_are_empty() -> None:
    assert [record.data for record in presentation.table(TABLE).records] == [
        {"mode": "a", "auc": "0.75 [0.50, 1.00]", "mcc": "0.1235", "runs": "1"},
        {"mode": "b", "auc": "n/a", "mcc": "", "runs": "2"},
    ]


def test_columns_have_unit_and_meaning() -> None:
    described = {column.name: column for column in presentation.columns(TABLE).columns}
    assert described["mcc"].type == "float64"
    assert described["mcc"].description == "Matthews correlation [1]"
    assert described["mode"].description == "the experiment; foreign: a recording from elsewhere"
    assert described["auc"].description is None
