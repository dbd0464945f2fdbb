"""The scores of recordings that arrived, night by night, as one picture."""

import pandas as pd

from oracle_pipeline.reporting.figures import AMBER, COLORS, INK, MARKERS, drawing
from oracle_pipeline.reporting.strip_plot import TICKS
from oracle_pipeline.scoring.verdict import Judgement

LATEST = 7  # recordings whose median the line shows
SHOWN = 2000  # scores
_STYLES: dict[Judgement, tuple[str, str]] = {
    "normal": (COLORS["normal"], MARKERS["normal"]),
    "anomalous": (COLORS["malicious"], MARKERS["malicious"]),
    "breach": (AMBER, MARKERS["control"]),
    "unsupported": (INK, "x"),
}


def trend(rows: pd.DataFrame) -> bytes:
    """Return the newest scores by the time of judgement as PNG; empty with fewer than two.

    Parameters
    ----------
    rows : DataFrame
        From `verdict_rows`.
    """
    scores = rows.dropna(subset="score").sort_values("judged_at").tail(SHOWN)
    scores = scores.assign(judged=pd.to_datetime(scores["judged_at"]))
    if len(scores) < 2:
        return b""
    with drawing(7.2, 2.8) as (axes, png):
        median = scores["score"].rolling(LATEST, min_periods=1).median()
        axes.plot(scores["judged"], median, color=INK, lw=1.0, label=f"median of the last {LATEST}")
        for outcome, (color, marker) in _STYLES.items():
            of_outcome = scores[scores["outcome"] == outcome]
            if len(of_outcome):
                axes.plot(
                    of_outcome["judged"], of_outcome["score"], marker, color=color, label=outcome
                )
        axes.set_yscale("asinh")
        axes.set_yticks([tick for tick in TICKS if tick <= scores["score"].max()] or [0])
        axes.yaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.set(ylabel="score", xlabel="judged")
        axes.grid(True, axis="y")
        axes.figure.autofmt_xdate(rotation=0, ha="center")
        axes.figure.legend(loc="outside upper right", ncols=5, fontsize="small")
    return png.getvalue()
