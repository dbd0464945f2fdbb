"""The badge of `oracle score --badge`: outcome, lowest p-value and date, as one small SVG."""

from collections.abc import Sequence
from datetime import date
from html import escape

from oracle_pipeline.scoring.output import EXIT_CODES, exit_code, tally
from oracle_pipeline.scoring.verdict import Verdict

_LABEL = "behaviour"
_COLOURS = {EXIT_CODES["normal"]: "#1b6a39", EXIT_CODES["anomalous"]: "#a3281b"}
_NO_VERDICT = "#7a5200"
_LETTER, _MARGIN = 6.6, 8.0  # mean width in Verdana of 11 px, and around each text [px]
_SVG = """\
<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="20" role="img" \
aria-label="{label}: {text}">
<title>{label}: {text}</title>
<rect width="{width:.0f}" height="20" rx="3" fill="#444c56"/>
<path d="M{left:.0f} 0h{rest:.0f}a3 3 0 0 1 3 3v14a3 3 0 0 1-3 3H{left:.0f}z" fill="{colour}"/>
<g fill="#fff" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">
<text x="{margin}" y="14">{label}</text>
<text x="{start:.0f}" y="14">{text}</text>
</g>
</svg>
"""


def as_badge(verdicts: Sequence[Verdict], today: date) -> bytes:
    """Return the badge as SVG."""
    p = [each.suite_p_value for each in verdicts if each.suite_p_value is not None]
    shown = [tally(verdicts), *([f"p {min(p):.2g}"] if p else []), today.isoformat()]
    text = " · ".join(shown)
    left, right = (_LETTER * len(each) + 2.0 * _MARGIN for each in (_LABEL, text))
    return _SVG.format(
        label=_LABEL, text=escape(text), colour=_COLOURS.get(exit_code(verdicts), _NO_VERDICT),
        width=left + right, left=left, rest=right - 3.0, start=left + _MARGIN, margin=_MARGIN,
    ).encode()  # fmt: skip
