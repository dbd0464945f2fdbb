"""The page on recordings from the inbox: a verdict for each, and the trend of scores.

One self-contained HTML file beside the report, from ``templates/arrivals.html.j2``.
"""

from collections import Counter
from collections.abc import Sequence

import pandas as pd

from oracle_pipeline.reporting.tables import evidence_table, table
from oracle_pipeline.reporting.templating import picture, template
from oracle_pipeline.reporting.trend import trend
from oracle_pipeline.scoring.kept_verdicts import KeptVerdict
from oracle_pipeline.scoring.output import family_as_text
from oracle_pipeline.scoring.verdict import Judgement

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


def arrivals_page(verdicts: Sequence[KeptVerdict]) -> str:
    """Return the page, with the verdicts in the given order."""
    listed = pd.DataFrame(
        [
            {
                "recording": kept.verdict.recording,
                "verdict": _IN_WORDS[kept.verdict.outcome],
                "p_value": kept.verdict.p_value,
                "score": kept.verdict.score,
                "far": kept.far,
                "judged_at": kept.judged_at,
            }
            for kept in verdicts
        ]
    )
    scores = trend(verdicts)
    return template("arrivals.html.j2").render(
        verdicts=verdicts,
        trend=[picture("Scores by the time of judgement", CAPTION, scores)] if scores else [],
        listed=table("arrivals", listed, links=[f"#{kept.key}" for kept in verdicts]),
        summary=summary(verdicts),
        words=_IN_WORDS,
        evidence_table=evidence_table,
        family=family_as_text,
    )


def summary(verdicts: Sequence[KeptVerdict]) -> str:
    """Return a sentence on the number of recordings of each outcome."""
    count = Counter(kept.verdict.outcome for kept in verdicts)
    parts = [f"{count[outcome]} {words}" for outcome, words in _IN_WORDS.items() if count[outcome]]
    noun = "recording" if len(verdicts) == 1 else "recordings"
    return f"{len(verdicts)} {noun}" + (f": {', '.join(parts)}." if parts else ".")
