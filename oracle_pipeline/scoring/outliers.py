"""Finds the outliers among the recordings of a reference.

An outlier raises the score that a recording needs to be anomalous, so a failed run among the normal
ones hides attacks. The user decides whether to keep it.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from oracle_pipeline.detectors.explain import Deviation, explain
from oracle_pipeline.scoring.card import ReferenceCard

OUTLYING = 5.0  # spreads of the normal scores above their median


class Outlier(NamedTuple):
    """A normal recording that is unlike the others."""

    name: str
    score: float  # held out, in spreads of the normal scores
    farthest: Deviation | None  # its most unusual feature, compared with the others


def outliers(card: ReferenceCard) -> Iterator[Outlier]:
    """Yield the recordings with held-out scores of at least `OUTLYING`, the highest first."""
    runs, scores = card.runs, card.scorer.held_out_
    for row in np.argsort(-scores, kind="stable").tolist():
        if scores[row] < OUTLYING:
            return
        own = runs["block"] == runs["block"].iloc[row]
        deviations = explain(runs[~own], runs.iloc[[row]], card.scorer.design.run_features)
        yield Outlier(
            str(runs["run_id"].iloc[row]), float(scores[row]), next(iter(deviations), None)
        )
