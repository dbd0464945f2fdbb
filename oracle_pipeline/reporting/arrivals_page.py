"""The page on recordings from the inbox: the newest, the most unusual, and the trend of scores.

One self-contained HTML file beside the report, from ``templates/arrivals.html.j2``.
"""

from collections import Counter
from collections.abc import Callable

import pandas as pd

from oracle_pipeline.reporting.tables import PageTable, evidence_table, table
from oracle_pipeline.reporting.templating import picture, template
from oracle_pipeline.reporting.trend import trend
from oracle_pipeline.scoring.kept_verdicts import KeptVerdict
from oracle_pipeline.scoring.output import family_as_text
from oracle_pipeline.scoring.verdict import Judgement

SHOWN = 50  # of the newest recordings, and of the most unusual
CAPTION = (
    "Scores night by night: 0 is the median of normal recordings, 1 their spread. Scores by "
    "different cards do not compare."
)
_IN_WORDS: dict[Judgement, str] = {
    "anomalous": "anomalous",
    "breach": "breaks the contract",
    "error": "could not be judged",
    "unsupported": "without a verdict",
    "another system": "of another system",
    "normal": "normal",
}


def arrivals_page(rows: pd.DataFrame, load: Callable[[str], KeptVerdict]) -> str:
    """Return the page.

    Parameters
    ----------
    rows : DataFrame
        From `verdict_rows`.
    load : callable
        Returns the verdict on a recording by its key; called for those that are shown.
    """
    newest, scores = rows.iloc[::-1].head(SHOWN), trend(rows)
    odd = rows[rows["outcome"] != "normal"]
    oddest = odd.sort_values("score", ascending=False, kind="stable").head(SHOWN)
    return template("arrivals.html.j2").render(
        verdicts=[load(key) for key in dict.fromkeys([*newest["key"], *oddest["key"]])],
        trend=[picture("Scores by the time of judgement", CAPTION, scores)] if scores else [],
        newest=_listed("arrivals", newest),
        oddest=_listed("oddest arrivals", oddest) if len(rows) > SHOWN else None,
        summary=summary(rows),
        shown=SHOWN,
        words=_IN_WORDS,
        evidence_table=evidence_table,
        family=family_as_text,
    )


def _listed(name: str, rows: pd.DataFrame) -> PageTable:
    words = rows.assign(verdict=rows["outcome"].map(_IN_WORDS))
    return table(name, words, links=[f"#{key}" for key in rows["key"]])


def summary(rows: pd.DataFrame) -> str:
    """Return a sentence on the number of recordings of each outcome."""
    count = Counter(rows["outcome"])
    parts = [f"{count[outcome]} {words}" for outcome, words in _IN_WORDS.items() if count[outcome]]
    noun = "recording" if len(rows) == 1 else "recordings"
    return f"{len(rows)} {noun}" + (f": {', '.join(parts)}." if parts else ".")
