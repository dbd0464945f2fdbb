"""The page of `oracle score --page`: each verdict with its picture and its evidence.

One self-contained HTML file that loads nothing from the network. Names and texts of a recording are
escaped, and pictures are drawn in separate processes, as features are computed.
"""

import base64
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.datasets import replacing
from oracle_pipeline.features import FeatureManager
from oracle_pipeline.reporting.page import template
from oracle_pipeline.scoring.isolation import Limits, run_isolated
from oracle_pipeline.scoring.output import (
    HEADINGS,
    MOST_BREACHES,
    beside,
    cells,
    family_as_text,
)
from oracle_pipeline.scoring.verdict import Evidence, Judgement, Verdict

_HEADLINES: dict[Judgement, str] = {
    "normal": "Normal",
    "breach": "Breach of the contract",
    "anomalous": "Anomalous",
    "unsupported": "No verdict",
    "error": "Could not be judged",
}


class _Row(NamedTuple):
    """One piece of evidence: its cells, a description of the feature, and where it stood out."""

    cells: Sequence[str]
    meaning: str
    place: str


class _Judged(NamedTuple):
    """One recording as the page shows it."""

    name: str
    outcome: Judgement
    headline: str
    sentences: Sequence[str]
    picture: str  # data URI; empty if it could not be drawn
    rows: Sequence[_Row]
    remarks: Sequence[str]


def write(
    path: Path,
    verdicts: Sequence[Verdict],
    far: float,
    notes: Sequence[str],
    manager: FeatureManager,
    limits: Limits,
    draw: Callable[[Path], bytes],
) -> None:
    """Write the page.

    Parameters
    ----------
    path : Path
        The file to write.
    verdicts : sequence of Verdict
    far : float
        The false positive rate of the verdicts.
    notes : sequence of str
        Remarks on the reference.
    manager : FeatureManager
        Provides the descriptions of the features.
    limits : Limits
        Of each process that draws a recording.
    draw : callable
        A picklable function that takes the path of a recording and returns its picture as PNG.
    """
    meanings = {name: feature.description for name, feature in manager.features().items()}
    page = template("verdicts.html.j2").render(
        judged=[_judged(verdict, far, meanings, limits, draw) for verdict in verdicts],
        headings=HEADINGS[:4],
        far=far,
        notes=notes,
    )
    with replacing(path) as sink:
        sink.write(printable(page).encode())


def _judged(
    verdict: Verdict,
    far: float,
    meanings: Mapping[str, str],
    limits: Limits,
    draw: Callable[[Path], bytes],
) -> _Judged:
    breaches, more = verdict.contract[:MOST_BREACHES], verdict.contract[MOST_BREACHES:]
    if more:
        breaches = (*breaches, f"The remarks list {len(more)} more breaches of the contract.")
    remarks, uri = [*more, *verdict.notes], ""
    if verdict.outcome != "error":
        try:
            png = run_isolated(draw, Path(verdict.recording), limits)
            uri = f"data:image/png;base64,{base64.b64encode(png).decode()}"
        except OracleError as error:
            remarks.append(f"It is not drawn: {error}")
    return _Judged(
        verdict.recording,
        verdict.outcome,
        _HEADLINES[verdict.outcome],
        [*breaches, _sentence(verdict, far), *beside(verdict)],
        uri,
        [_row(each, meanings.get(each.feature, "")) for each in verdict.evidence],
        [*map(family_as_text, verdict.families), *remarks],
    )


def _row(evidence: Evidence, meaning: str) -> _Row:
    """Return a row; window and topic have no columns, because two cards share a screen."""
    *shown, window, where = cells(evidence)
    return _Row(shown, meaning, ", ".join(filter(None, [where, window])))


def _sentence(verdict: Verdict, far: float) -> str:
    """Return a sentence that explains the p-value."""
    if verdict.p_value is None or verdict.suite_p_value is None:
        return verdict.error
    farther = round(verdict.p_value * (verdict.normal_blocks + 1)) - 1
    alone, suite = (f"{p:.3g}" for p in (verdict.p_value, verdict.suite_p_value))
    adjusted = f", adjusted for the whole set to {suite}" if suite != alone else ""
    return (
        f"Of {verdict.normal_blocks} normal recordings, {farther or 'none'} "
        f"{'is' if farther < 2 else 'are'} at least as unusual: p = {alone}{adjusted}. "
        f"Anomalous means a p of {far:g} or less."
    )
