"""Specified oracle: requirements that people wrote as formulas of signal temporal logic."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.features.engine.plugin import hookimpl
from oracle_pipeline.oracles.kind import KindError, Maker, TracedRuns
from oracle_pipeline.oracles.requirements import FARTHEST, Requirement, violations


@dataclass(frozen=True, slots=True)
class _Violations:
    """Computes the violation of requirements by a trace; hashable, to be cached."""

    requirements: tuple[Requirement, ...]

    def __call__(self, trace: pd.DataFrame) -> NDArray[np.float64]:
        return violations(self.requirements, trace)


class Specified:
    """The largest violation of a run; negative if all requirements hold.

    Parameters
    ----------
    requirements : sequence of Requirement
    """

    name = "specified"
    asks = "requirements"

    def __init__(self, requirements: Sequence[Requirement]) -> None:
        self.requirements = tuple(requirements)

    def learn(self, normal: TracedRuns) -> Self:
        """Return itself: there is nothing to learn.

        Raises
        ------
        KindError
            No run has the signals of any requirement.
        """
        if normal.traces and np.isnan(normal.each(_Violations(self.requirements))).all():
            raise KindError("No normal run has the required signals: try `oracle invariants`.")
        return self

    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return each run's largest violation of a requirement, in scales."""
        beyond = runs.each(_Violations(self.requirements))
        return np.asarray(np.nanmax(np.nan_to_num(beyond, nan=-FARTHEST), axis=1))


@hookimpl
def register_oracles() -> list[Maker]:
    """Register the oracle for the requirements, if there are any."""
    return [lambda material: Specified(material.requirements) if material.requirements else None]
