"""An estimate that is always printed with its interval, and functions that compute intervals."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import betaincinv, ndtri

LEVEL = 0.95  # of every interval in this package unless stated otherwise


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and its interval; all three are NaN if nothing could be measured.

    Examples
    --------
    >>> print(Estimate(0.5, 0.3125, 0.6875))
    0.50 [0.31, 0.69]
    >>> f"{Estimate(0.5, 0.3125, 0.6875):.3f}"
    '0.500 [0.312, 0.688]'
    >>> print(NOTHING)
    n/a
    """

    value: float
    low: float
    high: float

    def covers(self, value: float) -> bool:
        """Return whether the interval contains `value`; an empty estimate contains nothing."""
        return self.low <= value <= self.high

    @classmethod
    def of_row(cls, row: pd.Series, name: str) -> Self:
        """Return the estimate from the three columns that `columns` wrote to a table row."""
        return cls(*(float(row[f"{name}{end}"]) for end in ("", "_low", "_high")))

    def columns(self, name: str) -> dict[str, float]:
        """Return the three numbers as table columns ``name``, ``name_low`` and ``name_high``."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}

    def __format__(self, spec: str) -> str:
        if np.isnan(self.value):
            return "n/a"
        spec = spec or ".2f"
        return f"{self.value:{spec}} [{self.low:{spec}}, {self.high:{spec}}]"

    def __str__(self) -> str:
        return format(self)


NOTHING = Estimate(np.nan, np.nan, np.nan)  # could not be measured


def clopper_pearson(rate: float, n: float, level: float = LEVEL) -> Estimate:
    """Return a binomial rate with its exact (Clopper-Pearson) interval.

    Parameters
    ----------
    rate : float
        Share of successes, in [0, 1]; NaN gives no estimate.
    n : float
        Number of independent trials. With weighted rows this is the number of distinct runs, and
        ``rate * n`` need not be an integer [1]_.
    level : float
        Of confidence, two-sided.

    References
    ----------
    .. [1] E. L. Korn, B. I. Graubard, "Confidence intervals for proportions with small expected
       number of positive counts estimated from survey data", Survey Methodology 24, 1998.
    """
    if np.isnan(rate) or n <= 0:
        return NOTHING
    hits = rate * n
    tail = (1.0 - level) / 2.0
    low = betaincinv(hits, n - hits + 1.0, tail) if hits > 0 else 0.0
    high = betaincinv(hits + 1.0, n - hits, 1.0 - tail) if hits < n else 1.0
    return Estimate(float(rate), float(low), float(high))


def newcombe_auc(value: float, n_positive: int, n_negative: int, level: float = LEVEL) -> Estimate:
    """Return an AUC with Newcombe's score interval (method 5), which is valid at 0 and 1, too.

    At a level of 95%, the interval contains every AUC that is within 1.96 Hanley-McNeil standard
    errors of `value` [1]_. It is computed on a grid of 1e-4.

    References
    ----------
    .. [1] R. G. Newcombe, "Confidence intervals for an effect size measure based on the
       Mann-Whitney statistic. Part 2", Statistics in Medicine 25, 2006.
    """
    theta = np.linspace(0.0, 1.0, 10_001)
    pairs = (n_positive + n_negative) / 2.0 - 1.0
    shape = 1.0 + pairs * ((1.0 - theta) / (2.0 - theta) + theta / (1.0 + theta))
    variance = theta * (1.0 - theta) * shape / (n_positive * n_negative)
    z = ndtri((1.0 + level) / 2.0)
    plausible: NDArray[np.float64] = theta[np.abs(theta - value) <= z * np.sqrt(variance)]
    return Estimate(value, float(plausible.min(initial=value)), float(plausible.max(initial=value)))
