"""Implicit oracle: finds failures that are wrong for any robot and task, without written rules.

These are a goal that failed or never ended, an error in the log, numbers that are not finite, and
periodic topics that fell silent.
"""

from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.features.engine.plugin import hookimpl
from oracle_pipeline.oracles.kind import Maker, TracedRuns
from oracle_pipeline.oracles.traces import STEP_S

_COUNTS = ("goals_failed", "errors", "non_finite")  # cumulative: the last value is the total


class Implicit:
    """The sum of ``ln(1 + n)`` over the number of each failure, and the seconds of silence."""

    name = "implicit"
    asks = "nothing"

    def learn(self, normal: TracedRuns) -> Self:  # noqa: ARG002 -- there is nothing to learn
        """Return itself."""
        return self

    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return the score of each run; 0 without failures."""
        return np.asarray(np.log1p(runs.each(_failures)).sum(axis=1), dtype=np.float64)


def _failures(trace: pd.DataFrame) -> NDArray[np.float64]:
    """Return the numbers of failed goals, logged errors, non-finite numbers, and silence [s].

    The last value is the number of goals that were still active at the end.
    """
    totals = [float(trace[name].fillna(0.0).iloc[-1]) if len(trace) else 0.0 for name in _COUNTS]
    silent_s = float(trace["quiet_topics"].fillna(0.0).sum()) * STEP_S
    unfinished = float(len(trace) > 0 and trace["goal_time"].iloc[-1] > 0.0)
    return np.array([*totals, silent_s, unfinished])


@hookimpl
def register_oracles() -> list[Maker]:
    """Register the implicit oracle."""
    return [lambda _: Implicit()]
