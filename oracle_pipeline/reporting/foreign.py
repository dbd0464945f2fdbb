"""The page on recordings from the inbox: a verdict for each, with its evidence.

One self-contained HTML file beside the report, from ``templates/foreign.html.j2``.
"""

from collections import Counter
from collections.abc import Sequence

from oracle_pipeline.reporting.page import template
from oracle_pipeline.scoring.kept_verdicts import KeptVerdict
from oracle_pipeline.scoring.output import HEADINGS, cells, family_as_text
from oracle_pipeline.scoring.verdict import Judgement

_IN_WORDS: dict[Judgement, str] = {
    "anomalous": "anomalous",
    "breach": "breaks the contract",
    "error": "could not be judged",
    "unsupported": "without a verdict",
    "normal": "normal",
}


def foreign_page(verdicts: Sequence[KeptVerdict]) -> str:
    """Return the page, with the verdicts in the given order."""
    return template("foreign.html.j2").render(
        verdicts=verdicts,
        summary=summary(verdicts),
        words=_IN_WORDS,
        headings=HEADINGS,
        cells=cells,
        family=family_as_text,
    )


def summary(verdicts: Sequence[KeptVerdict]) -> str:
    """Return a sentence on the number of recordings of each outcome."""
    count = Counter(kept.verdict.outcome for kept in verdicts)
    parts = [f"{count[outcome]} {words}" for outcome, words in _IN_WORDS.items() if count[outcome]]
    noun = "recording" if len(verdicts) == 1 else "recordings"
    return f"{len(verdicts)} {noun}" + (f": {', '.join(parts)}." if parts else ".")
