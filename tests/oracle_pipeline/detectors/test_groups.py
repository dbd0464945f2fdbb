"""One clear topic is never diluted by a hundred quiet ones."""

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.detectors import LargestGroup, SignalScaler

TOPICS = 100
GROUPS = [f"/{topic}" for topic in range(TOPICS) for _ in range(3)]


def test_change_in_one_of_a_hundred_topics_stands_out():
    rng = np.random.default_rng(0)
    normal, new = rng.normal(size=(20, 3 * TOPICS)), rng.normal(size=(2, 3 * TOPICS))
    new[1, 30:33] += 12.0
    detector = LargestGroup(GROUPS).fit(normal)
    unchanged, changed = -detector.score_samples(new)
    assert changed > 2.0 * unchanged


def test_scale_is_not_that_of_the_unchanging_majority():
    column = np.array([0.0] * 15 + [1.0] * 5)
    scaler = SignalScaler({}).fit(pd.DataFrame({"a": column}))
    assert abs(scaler.transform(pd.DataFrame({"a": [1.0]}))[0, 0]) < 5.0


def test_change_of_a_constant_counts_but_not_for_all():
    scaler = SignalScaler({}).fit(pd.DataFrame({"a": np.ones(20), "b": np.arange(20.0)}))
    changed = scaler.transform(pd.DataFrame({"a": [7.0], "b": [1e6]}))[0]
    assert changed == pytest.approx([5.0, 50.0])
