"""The section on searches for attacks: a table of results, and a picture of each Pareto front."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.layout import FINDINGS, FRONT, searches
from oracle_pipeline.reporting.tables import PageTable, plain_table
from oracle_pipeline.reporting.templating import Picture, picture


class Searched(NamedTuple):
    """The content of the section on searches."""

    table: PageTable
    fronts: Sequence[Picture]


def searched(root: Path) -> Searched | None:
    """Return the section on the searches below a root; None if there are none.

    Raises
    ------
    OracleError
        The findings of a search cannot be read.
    """
    folders = searches(root)
    if not folders:
        return None
    rows = [_row(folder) for folder in folders]
    fronts = [
        picture(f"Effect over score, search of {folder.name}", folder.name, png.read_bytes())
        for folder in folders
        if (png := folder / FRONT).is_file()
    ]
    return Searched(plain_table("Searches", pd.DataFrame(rows)), fronts)


def _row(folder: Path) -> dict[str, Any]:
    path = folder / FINDINGS
    try:
        document = json.loads(path.read_text("utf-8"))
        findings = document["findings"]
        ran = [each for each in findings if not each["screened_out"]]
        effects = [each for each in ran if each["effect"] >= 1.0]
        passed = [each for each in effects if each["passed"]]
        most = depends_on(document.get("impacts", {}))
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise OracleError(f"{path} cannot be read ({error}); search again.") from error
    return {
        "scenario": folder.name,
        "proposals": len(findings),
        "run in closed loop": len(ran),
        "with an effect on the task": len(effects),
        "of these missed by the oracle": len(passed),
        "largest missed effect": max((each["effect"] for each in passed), default=0.0),
        "lowest score with an effect": min((each["score"] for each in effects), default=None),
        "the effect depends most on": most,
    }


def depends_on(impacts: Mapping[str, float]) -> str:
    """Return the parameters with the largest shares of the variance of a result."""
    first = sorted(impacts, key=lambda name: -impacts[name])[:3]
    return ", ".join(f"{name} ({impacts[name]:.0%})" for name in first)
