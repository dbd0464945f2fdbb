"""The thesis's method on runs whose labels are meaningless.

The durations of the thesis's runs are not published. Here they are as in navigation: most runs are
similar, and a few are many times longer, as after recoveries or at a timeout. No feature of a run
depends on its label, so any "accuracy" is due to chance.
"""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bootstrap import distinct_runs
from oracle_pipeline.evaluation.clustering_result import grow_over_rows, in_best_cluster
from oracle_pipeline.evaluation.metrics import BAND, confusion
from oracle_pipeline.evaluation.variants import THESIS
from oracle_pipeline.features.traffic.thesis_features import VECTOR
from tools.bench.figures import Row

RUNS_OF_MODE = 15  # as in the thesis, hence 90 runs
MEDIAN_S, SPREAD = 210.0, 0.35  # of the log-normal durations; the spread is of their logarithm
LONG_RUN_S = (800.0, 3600.0)  # from several recoveries to the timeout of the thesis


def label_free_runs(p_long: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return as many runs as the thesis had, with features that do not depend on labels.

    Parameters
    ----------
    p_long : float
        Share of runs that take very long.
    rng : Generator

    Returns
    -------
    DataFrame of 90 rows
        Half malicious. Nine of the ten features are noise, and negligible beside the nanoseconds.
    """
    n = 2 * len(PAIRS) * RUNS_OF_MODE
    duration_s = MEDIAN_S * np.exp(SPREAD * rng.normal(size=n))
    duration_s = np.where(rng.random(n) < p_long, rng.uniform(*LONG_RUN_S, n), duration_s)
    features = np.column_stack([rng.normal(size=(n, len(VECTOR) - 1)), 1e9 * duration_s])
    df = pd.DataFrame(features, columns=list(VECTOR))
    label = np.repeat(["normal", "malicious"], n // 2)
    run_id = [f"run{run:03d}" for run in range(n)]
    return df.assign(run_id=run_id, label=label, block=np.arange(n))


def best_cluster_rates(
    p_long: float, repetitions: int, seed: int, n: int = 1000, malicious_rate: float = 0.3
) -> pd.DataFrame:
    """Apply the thesis's variant, Ward and two clusters, repeatedly to label-free runs.

    Parameters
    ----------
    p_long : float
        Share of runs that take very long.
    repetitions : int
        Number of experiments, each with new runs.
    seed : int
        Of the generator of the runs; rows are always drawn as in the thesis.
    n : int
        Rows of each bootstrap.
    malicious_rate : float
        Share of malicious rows.

    Returns
    -------
    DataFrame of `repetitions` rows
        Of the best cluster: ``recall`` (the thesis's "accuracy"), ``fpr`` and ``auc`` (of the hard
        verdict, as there).
    """
    table = []
    for rng in np.random.default_rng(seed).spawn(repetitions):
        rows = THESIS.draw(label_free_runs(p_long, rng), n, malicious_rate, 50)
        runs = distinct_runs(rows)
        clusters = grow_over_rows(rows, VECTOR, "ward", THESIS).cut("maxclust", 2.0)[runs.first]
        counts = confusion(in_best_cluster(clusters, runs), runs)
        auc = (counts.tpr + 1.0 - counts.fpr) / 2.0
        table.append({"recall": counts.tpr, "fpr": counts.fpr, "auc": auc})
    return pd.DataFrame(table)


def rows() -> Iterator[Row]:
    """Yield median and 95% range of 50 experiments, by figure and share of very long runs."""
    for p_long in (0.0, 0.02, 0.05, 0.1):
        rates = best_cluster_rates(p_long, 50, 50)
        for name, values in rates.items():
            low, high = np.percentile(values, BAND)
            remark = f"[{low:.2f}, {high:.2f}]"
            yield Row(f"{p_long:.0%} very long runs: {name}", float(values.median()), remark=remark)
