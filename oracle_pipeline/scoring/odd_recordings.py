"""Which recordings of a reference are unlike the others.

Each raises the score that a recording needs to be anomalous, so a run that went wrong among the
normal ones hides attacks. A person decides whether it stays.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from oracle_pipeline.detectors.explain import Deviation, explain
from oracle_pipeline.scoring.card import ReferenceCard

ODD = 5.0  # spreads of the normal scores above their median


class OddRecording(NamedTuple):
    """A normal recording that the others do not explain."""

    name: str
    score: float  # by the scorer that did not see it, in spreads of the normal scores
    farthest: Deviation | None  # of its features, in comparison with the others


def odd_recordings(card: ReferenceCard) -> Iterator[OddRecording]:
    """Yield the recordings of a card that score `ODD` or more when held out, the oddest first."""
    runs, scores = card.runs, card.scorer.held_out_
    for row in np.argsort(-scores, kind="stable").tolist():
        if scores[row] < ODD:
            return
        own = runs["block"] == runs["block"].iloc[row]
        deviations = explain(runs[~own], runs.iloc[[row]], card.scorer.design.run_features)
        yield OddRecording(
            str(runs["run_id"].iloc[row]), float(scores[row]), next(iter(deviations), None)
        )
