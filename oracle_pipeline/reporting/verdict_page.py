"""The page of `oracle score --page`: each verdict with its picture and its evidence.

One self-contained HTML file that loads nothing from the network. Names and texts of a recording are
escaped, and pictures are drawn in separate processes, as features are computed.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.datasets import replacing
from oracle_pipeline.features import FeatureManager
from oracle_pipeline.reporting.templating import png_uri, template
from oracle_pipeline.scoring.isolation import Limits, run_isolated
from oracle_pipeline.scoring.output import (
    HEADINGS,
    MOST_BREACHES,
    beside,
    breaches,
    cards,
    cells,
    family_as_text,
    tally,
)
from oracle_pipeline.scoring.sentences import headline
from oracle_pipeline.scoring.verdict import Judgement, Verdict

_HEADLINES: dict[Judgement, str] = {
    "normal": "Normal",
    "breach": "Breach of the contract",
    "anomalous": "Anomalous",
    "unsupported": "No verdict",
    "another system": "Another system",
    "error": "Could not be judged",
}


class _Shown(NamedTuple):
    """One verdict, with its texts and its picture as the page shows them."""

    verdict: Verdict
    sentences: Sequence[str]
    picture: str  # data URI; empty if it could not be drawn
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
    page = template("verdicts.html.j2").render(
        headline=headline,
        tally=tally(verdicts),
        judged=[_shown(verdict, far, limits, draw) for verdict in verdicts],
        words=_HEADLINES,
        meanings={name: feature.description for name, feature in manager.features().items()},
        headings=HEADINGS[:4],
        cells=cells,
        far=far,
        notes=[*cards(verdicts), *notes],
    )
    with replacing(path) as sink:
        sink.write(printable(page).encode())


def _shown(verdict: Verdict, far: float, limits: Limits, draw: Callable[[Path], bytes]) -> _Shown:
    more, picture = verdict.contract[MOST_BREACHES:], ""
    remarks = [*map(family_as_text, verdict.families), *more, *verdict.notes]
    if verdict.outcome != "error":
        try:
            picture = png_uri(run_isolated(draw, Path(verdict.recording), limits))
        except OracleError as error:
            remarks.append(f"It is not drawn: {error}")
    sentences = [
        *verdict.cautions, *breaches(verdict, "the remarks list all"), _sentence(verdict, far),
        *verdict.differences, *beside(verdict),
    ]  # fmt: skip
    return _Shown(verdict, sentences, picture, remarks)


def _sentence(verdict: Verdict, far: float) -> str:
    """Return a sentence that explains the p-value."""
    if verdict.p_value is None or verdict.suite_p_value is None:
        return headline(verdict)
    farther = round(verdict.p_value * (verdict.normal_blocks + 1)) - 1
    alone, suite = (f"{p:.3g}" for p in (verdict.p_value, verdict.suite_p_value))
    adjusted = f", adjusted for the whole set to {suite}" if suite != alone else ""
    return (
        f"Of {verdict.normal_blocks} normal recordings, {farther or 'none'} "
        f"{'is' if farther < 2 else 'are'} at least as unusual: p = {alone}{adjusted}. "
        f"Anomalous means a p of {far:g} or less."
    )
