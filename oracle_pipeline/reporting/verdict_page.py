"""The page of `oracle score --page`: each verdict with its film and its evidence.

One self-contained HTML file that loads nothing from the network. Names and texts of a recording are
escaped, and pictures are drawn in separate processes, as features are computed. The only script is
ours, and browsers run no other: the page states its hash.
"""

import base64
import hashlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.terminal import printable
from oracle_pipeline.datasets import replacing
from oracle_pipeline.features import FeatureManager
from oracle_pipeline.reporting.signal_plots import (
    SignalPlot,
    first_evidence,
    length_s,
    signal_plots,
)
from oracle_pipeline.reporting.templating import png_uri, template
from oracle_pipeline.scoring import output
from oracle_pipeline.scoring.isolation import Limits, isolated_each
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

FRAMES = 60  # of a film
MOST_FILMS = 10  # of a page, which has a megabyte for each; further recordings have a picture


class Draw(Protocol):
    """Draws a recording; picklable."""

    def __call__(self, recording: Path, /, number: int) -> Sequence[tuple[float, bytes]]:
        """Return about some number of pictures, each as time [s] and PNG; one shows the whole."""


class _Shown(NamedTuple):
    """One verdict, with its texts, pictures and plots as the page shows them."""

    verdict: Verdict
    sentences: Sequence[str]
    film: Sequence[tuple[float, str]]  # time [s] and data URI; empty if it could not be drawn
    plots: Sequence[SignalPlot]
    start_s: float  # of the slider: where the first evidence begins
    length_s: float  # of the slider; 0 without one
    remarks: Sequence[str]

    @property
    def first_frame(self) -> int:
        """Index of the frame at the start of the slider."""
        return max((n for n, (at, _) in enumerate(self.film) if at <= self.start_s), default=0)


def write(
    path: Path, verdicts: Sequence[Verdict], far: float, notes: Sequence[str],
    manager: FeatureManager, limits: Limits, draw: Draw,
) -> None:  # fmt: skip
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
    draw : Draw
    """
    script = template("scrub.js").render()
    odd = [verdict for verdict in verdicts if verdict.outcome not in ("normal", "error")]
    filmed = odd[:MOST_FILMS]

    films = isolated_each(
        [
            (partial(draw, number=FRAMES if verdict in filmed else 1), Path(verdict.recording))
            for verdict in verdicts
            if verdict.outcome != "error"
        ],
        limits,
    )
    page = template("verdicts.html.j2").render(
        headline=headline,
        tally=output.tally(verdicts),
        judged=[
            _shown(verdict, far, () if verdict.outcome == "error" else next(films))
            for verdict in verdicts
        ],
        script=script,
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        words=_HEADLINES,
        meanings={name: feature.description for name, feature in manager.features().items()},
        headings=output.HEADINGS[:4],
        cells=output.cells,
        far=far,
        notes=[*output.cards(verdicts), *notes],
    )
    with replacing(path) as sink:
        sink.write(printable(page).encode())


def _shown(
    verdict: Verdict, far: float, frames: Sequence[tuple[float, bytes]] | OracleError
) -> _Shown:
    more = verdict.contract[output.MOST_TOLD :]
    remarks = [*map(output.family_as_text, verdict.families), *more, *verdict.notes]
    if isinstance(frames, OracleError):
        remarks.append(f"It is not drawn: {frames}")
        frames = ()
    sentences = [
        *verdict.cautions, *output.breaches(verdict, "; the remarks list all"),
        _sentence(verdict, far), *verdict.differences, *output.beside(verdict),
    ]  # fmt: skip
    length = max([length_s(verdict), *(at for at, _ in frames)])
    told = first_evidence(verdict)
    return _Shown(
        verdict, sentences, [(at, png_uri(png)) for at, png in frames],
        signal_plots(verdict, length), (told and told.window_start_s) or 0.0, length, remarks,
    )  # fmt: skip


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
