"""Campaigns of a few runs with given windows and ground truth."""

import numpy as np
import pandas as pd

from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from oracle_pipeline.windows import HOP_S, MIN_WINDOW_S
from tests.oracle_pipeline.datasets.synthetic import MODES, campaign


def by_hand(*runs):
    """Return a campaign of runs given as (mode, block, recording_s, onset_s, changes)."""
    keys = [
        {
            "run_id": f"{mode}|run{block:03d}",
            "mode": mode,
            "label": MODES.get(mode, "normal"),
            "block": block,
            "session": block % 3,
            "world": "hexagon-0",
        }
        for mode, block, *_ in runs
    ]
    features = pd.DataFrame(keys).assign(**{"some.value": 0.0})
    windows = pd.concat(
        [
            features.iloc[[row]].merge(
                pd.DataFrame({"window_start_s": np.arange(0.0, length - MIN_WINDOW_S, HOP_S)}),
                how="cross",
            )
            for row, (_, _, length, *_) in enumerate(runs)
        ]
    )
    truth = pd.DataFrame(
        {
            "run_id": features["run_id"],
            "onset_s": [onset for *_, onset, _ in runs],
            "recording_s": [length for _, _, length, *_ in runs],
            "changes": [changes for *_, changes in runs],
        }
    )
    return JudgedRuns.of(features, windows, truth)


def synthetic(runs=9, effect=0.0, seed=0, **more):
    return JudgedRuns.of(*campaign(runs, effect, seed, **more))
