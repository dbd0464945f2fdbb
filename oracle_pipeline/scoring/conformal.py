"""Split-conformal p-values: from scores to verdicts with a known false positive rate.

A run is compared with calibration runs: normal runs that the detector was not fitted on. If it is
exchangeable with them, its p-value is at most ``alpha`` with a probability of at most ``alpha``,
for any detector and any distribution of scores [1]_. Higher scores are more anomalous.

References
----------
.. [1] S. Bates, E. Candès, L. Lei, Y. Romano, M. Sesia, "Testing for outliers with conformal
   p-values", Annals of Statistics 51, 2023.
"""

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import OracleError


class ConformalError(OracleError):
    """There are too few calibration runs for the requested false positive rate."""


def p_values(calibration: NDArray[np.float64], scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``(1 + #{calibration >= score}) / (n + 1)`` for each score.

    Parameters
    ----------
    calibration : ndarray of shape (n,)
        Scores of runs that the detector was not fitted on.
    scores : ndarray of shape (m,)

    Returns
    -------
    ndarray of shape (m,)
        In ``[1 / (n + 1), 1]``.

    Raises
    ------
    ConformalError
        A score is not a finite number.

    Examples
    --------
    >>> p_values(np.array([1.0, 2.0, 3.0]), np.array([0.5, 2.0, 9.0]))
    array([1.  , 0.75, 0.25])
    """
    if not (np.isfinite(calibration).all() and np.isfinite(scores).all()):
        raise ConformalError(
            "A score is not a finite number, so it cannot be ranked; look for a feature that has "
            "no finite value in the runs that the detector was fitted on."
        )
    n = len(calibration)
    at_least = n - np.searchsorted(np.sort(calibration), scores, side="left")
    return np.asarray((1.0 + at_least) / (n + 1.0), dtype=np.float64)


def check_rate(rate: float) -> None:
    """Raise a `ConformalError` unless a false positive rate is above 0 and below 1."""
    if not 0.0 < rate < 1.0:
        raise ConformalError(
            f"A false positive rate of {rate:g} is invalid; give one between 0 and 1."
        )


def runs_needed(rate: float) -> int:
    """Return the smallest number of calibration runs that can give a p-value of at most `rate`.

    Examples
    --------
    >>> runs_needed(0.05), runs_needed(0.01)
    (19, 99)
    """
    check_rate(rate)
    count = int(1.0 / rate)
    return count - 1 if 1.0 / count <= rate else count


def check_support(n_calibration: int, rate: float) -> None:
    """Raise an error if there are too few calibration runs for a false positive rate.

    Raises
    ------
    ConformalError
        There are too few; the message states how many are needed.
    """
    needed = runs_needed(rate)
    if n_calibration < needed:
        raise ConformalError(
            f"{n_calibration} calibration runs cannot support a false positive rate of {rate:.3g}: "
            f"no run could be called anomalous, however unusual it is. {needed} are needed; add "
            "normal runs to the reference, or choose a higher rate."
        )


def adjusted_for_suite(p: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Benjamini-Hochberg p-values of runs that are judged together.

    If runs with a p-value up to `rate` are called anomalous, on average at most that share of them
    is normal. The procedure remains valid for p-values that share calibration runs.

    Examples
    --------
    >>> adjusted_for_suite(np.array([0.01, 0.04, 0.5]))
    array([0.03, 0.06, 0.5 ])
    """
    from scipy.stats import false_discovery_control  # takes a while to import

    return np.asarray(false_discovery_control(p, method="bh"), dtype=np.float64)
