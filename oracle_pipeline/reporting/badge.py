"""The badge of `oracle score --badge`: outcome, lowest p-value and date, as one small SVG."""

from collections.abc import Sequence
from datetime import date

from oracle_pipeline.reporting.templating import template
from oracle_pipeline.scoring.output import EXIT_CODES, exit_code, tally
from oracle_pipeline.scoring.verdict import Verdict

_LABEL = "behaviour"
_COLOURS = {EXIT_CODES["normal"]: "#1b6a39", EXIT_CODES["anomalous"]: "#a3281b"}
_NO_VERDICT = "#7a5200"
_LETTER, _MARGIN = 6.6, 8.0  # mean width in Verdana of 11 px, and around each text [px]


def as_badge(verdicts: Sequence[Verdict], today: date) -> bytes:
    """Return the badge as SVG."""
    p = [each.suite_p_value for each in verdicts if each.suite_p_value is not None]
    shown = [tally(verdicts), *([f"p {min(p):.2g}"] if p else []), today.isoformat()]
    text = " · ".join(shown)
    left, right = (_LETTER * len(each) + 2.0 * _MARGIN for each in (_LABEL, text))
    return (
        template("badge.svg.j2")
        .render(
            label=_LABEL, text=text, colour=_COLOURS.get(exit_code(verdicts), _NO_VERDICT),
            width=left + right, left=left, start=left + _MARGIN, margin=_MARGIN,
        )
        .encode()
    )  # fmt: skip
