"""Synthetic runs that also have the thesis's ten features."""

import numpy as np
import pandas as pd

from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.features.traffic.thesis_features import VECTOR
from tests.oracle_pipeline.datasets.synthetic import run_features


def thesis_runs(runs: int = 15, effect: float = 0.0, seed: int = 0) -> pd.DataFrame:
    """Return runs of six modes; attacks shift degree variance by `effect`, others less.

    Durations are far apart in nanoseconds, as in a real campaign, and do not depend on the attack.
    """
    df = run_features(runs, effect, seed)
    rng = np.random.default_rng(seed)
    numbers = rng.normal(size=(len(df), len(VECTOR)))
    numbers[is_malicious(df)] += effect
    numbers[:, VECTOR.index("thesis.variance")] *= 10.0
    numbers[:, VECTOR.index("thesis.duration_ns")] = 1e9 * df["contextual.duration"]
    return df.assign(**dict(zip(VECTOR, numbers.T, strict=True)))
