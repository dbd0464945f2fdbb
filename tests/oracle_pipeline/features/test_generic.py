import json

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline import features
from oracle_pipeline.datasets import feature_columns
from oracle_pipeline.features import FeatureManager
from oracle_pipeline.features.traffic import generic, topic_pairs
from oracle_pipeline.opened_run import open_run

MANAGER = FeatureManager((*generic.register_features(), *topic_pairs.register_features()))


def extract(path) -> dict[str, object]:
    """Return the row of the run, with the places of the values as ``where``."""
    with open_run(path) as run:
        row = features.extract(run, MANAGER).run.iloc[0].to_dict()
    row["where"], row["missing"] = json.loads(row["where"]), json.loads(row["missing"])
    return row


def scans(messages, topic, arrays, period_s=0.2, delay_s=0.0):
    return [
        (i * period_s + delay_s, topic, messages.scan(i * period_s, array))
        for i, array in enumerate(arrays)
    ]


def smooth(n, rng, noise=0.0):
    """Scans of a smooth world, with noise relative to the range."""
    angle = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
    base = 2.0 + np.sin(angle)
    return [base * (1.0 + noise * rng.uniform(-1.0, 1.0, 180)) for _ in range(n)]


def test_columns_are_the_same_for_every_bag(make_run, foreign_bag, bag_of):
    tables = []
    for path in (make_run().path, foreign_bag):
        with open_run(path) as run:
            tables.append(features.extract(run, MANAGER))
    for one, other in zip(*tables, strict=True):
        assert feature_columns(one) == feature_columns(other)
    windowed = {column for column, each in MANAGER.features().items() if each.per_window}
    assert windowed == set(feature_columns(tables[0].windows))


def test_timing_of_a_bag(bag_of, messages):
    recorded = [(float(i), "/even", messages.goal_status(i)) for i in range(30)]
    del recorded[10]  # a gap of two periods
    recorded += [(i * i / 29.0, "/uneven", messages.goal_status(i)) for i in range(30)]
    recorded += [(0.5, "/once", messages.goal_status(0))]  # neither steady nor unsteady
    row = extract(bag_of(sorted(recorded, key=lambda each: each[0])))
    assert row["generic.message_rate"] == pytest.approx(60 / 29)
    assert row["generic.byte_rate"] == pytest.approx(60 * 8 / 29)
    assert row["generic.steady_topics"] == 0.5
    assert row["generic.silent_topics"] == 0.0
    assert row["generic.jitter_max"] == 0.0
    assert row["generic.gap_max"] == pytest.approx(2.0)
    assert row["where"]["generic.gap_max"] == "/even"
    assert "header" in row["missing"]["generic.out_of_order_max"]


def test_jitter_is_the_spread_of_the_periods_over_the_period(bag_of, messages):
    times = np.cumsum([1.0, 0.9, 1.1] * 10)
    row = extract(bag_of([(t, "/even", messages.goal_status(t)) for t in times]))
    assert row["generic.jitter_max"] == pytest.approx(0.1)


def test_stamps_that_go_back_are_counted(bag_of, messages):
    stamps = [0, 1, 3, 2, 4]
    recorded = [(float(i), "/scan", messages.scan(s, [1.0])) for i, s in enumerate(stamps)]
    row = extract(bag_of(recorded))
    assert row["generic.out_of_order_max"] == 0.25
    assert row["where"]["generic.out_of_order_max"] == "/scan"


def test_a_topic_that_falls_silent_is_seen_in_the_window(bag_of, messages):
    recorded = [(float(i), "/a", messages.goal_status(i)) for i in range(30)]
    recorded += [(float(i), "/b", messages.goal_status(i)) for i in range(15)]
    with open_run(bag_of(sorted(recorded, key=lambda each: each[0]))) as run:
        windows = features.extract(run, MANAGER).windows
    assert windows["generic.silent_topics"].tolist() == 6 * [0.0] + 5 * [0.5]


def test_noise_makes_bytes_harder_to_compress_and_arrays_rough(bag_of, messages, tmp_path):
    rng = np.random.default_rng(1)
    rows = []
    for noise in (0.0, 0.1):
        bag = bag_of(scans(messages, "/scan", smooth(50, rng, noise)))
        rows.append(extract(bag))
        bag.rename(tmp_path / f"noise{noise}")
    for name in ("zlib_ratio_max", "byte_entropy_max", "roughness_max"):
        assert rows[1][f"generic.{name}"] > rows[0][f"generic.{name}"]
    assert rows[0]["generic.roughness_max"] < 1e-3
    assert rows[0]["generic.autocorrelation_min"] > 0.99
    # abs(a - 2 b + c) of three uniform numbers is below m with probability (m - m^3 / 24) / 2.
    assert rows[1]["generic.roughness_max"] == pytest.approx(0.1 * 1.045, rel=0.05)


def test_the_share_of_rays_without_return(bag_of, messages):
    array = np.full(100, 2.0)
    array[:25] = np.inf
    row = extract(bag_of(scans(messages, "/scan", [array] * 10)))
    assert row["generic.non_finite_max"] == 0.25
    assert row["generic.at_limit_max"] == 1.0
    assert row["generic.distinct_max"] == pytest.approx(1 / 75)
    assert "generic.autocorrelation_max" in row["missing"]  # all are equal


def test_a_relay_that_changes_nothing_differs_in_nothing(bag_of, messages):
    arrays = smooth(50, np.random.default_rng(2), 0.1)
    recorded = scans(messages, "/scan", arrays) + scans(messages, "/copy", arrays, delay_s=0.01)
    row = extract(bag_of(sorted(recorded, key=lambda each: each[0])))
    assert row["pairs.rank_difference_max"] == pytest.approx(0.0, abs=1e-12)
    assert row["pairs.histogram_distance"] == 0.0
    assert row["pairs.roughness_ratio"] == 0.0
    assert row["pairs.rate_ratio"] == 0.0
    assert row["pairs.identity"] == 1.0
    assert row["where"]["pairs.identity"] == "/copy against /scan"


def test_a_relay_that_adds_noise_differs_the_more_the_more_it_adds(bag_of, messages, tmp_path):
    rng = np.random.default_rng(3)
    rows = []
    for noise in (0.02, 0.1):
        recorded = scans(messages, "/scan", smooth(50, rng, 0.01))
        recorded += scans(messages, "/noisy", smooth(50, rng, noise), delay_s=0.01)
        bag = bag_of(sorted(recorded, key=lambda each: each[0]))
        rows.append(extract(bag))
        bag.rename(tmp_path / f"noise{noise}")
        assert rows[-1]["pairs.identity"] == 0.0
    assert 0.0 < rows[0]["pairs.rank_difference_max"] < rows[1]["pairs.rank_difference_max"]
    assert rows[0]["pairs.roughness_ratio"] == pytest.approx(np.log(2.0), abs=0.1)
    assert rows[1]["pairs.roughness_ratio"] == pytest.approx(np.log(10.0), abs=0.1)


def test_the_distance_of_histograms_is_wassersteins(bag_of, messages):
    angle = np.linspace(0.0, 1.0, 100)
    recorded = scans(messages, "/a", [angle] * 20) + scans(messages, "/b", [angle + 1.0] * 20)
    row = extract(bag_of(sorted(recorded, key=lambda each: each[0])))
    # Moved by 1 within a range of 2, of which the outermost thousandths are left out.
    assert row["pairs.histogram_distance"] == pytest.approx(0.5, abs=0.01)


def test_rates_are_compared(bag_of, messages):
    arrays = smooth(40, np.random.default_rng(4))
    recorded = scans(messages, "/a", arrays) + scans(messages, "/b", arrays[:20], period_s=0.4)
    row = extract(bag_of(sorted(recorded, key=lambda each: each[0])))
    assert row["pairs.rate_ratio"] == pytest.approx(np.log(2.0))


def test_of_many_topics_those_that_look_alike_are_compared(bag_of, messages):
    rng = np.random.default_rng(0)
    sent = [
        (t, f"/scan{n}", messages.scan(t, 1.0 + n + rng.random(20))) for n in range(30)
        for t in range(3)
    ]  # fmt: skip
    relayed = [(t, "/relay", m) for t, topic, m in sent if topic == "/scan17"]
    with open_run(bag_of([*sent, *relayed])) as run:
        row = features.extract(run, features.build_manager()).run.iloc[0]
    assert row["pairs.identity"] == 1.0
    assert json.loads(row["where"])["pairs.identity"] == "/relay against /scan17"


def test_a_topic_alone_makes_no_pair(bag_of, messages):
    row = extract(bag_of(scans(messages, "/scan", smooth(20, np.random.default_rng(5)))))
    assert pd.isna(row["pairs.identity"])
    assert row["missing"]["pairs.identity"] == "no two topics of the same type have arrays"
