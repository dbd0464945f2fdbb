import numpy as np
import pytest

from oracle_pipeline.clustering.scaling import CLIP
from oracle_pipeline.evaluation.run_deviations import deviations_of_runs
from oracle_pipeline.evaluation.unusual_windows import unusual_windows
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.evidence import evidence
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from oracle_pipeline.windows import WINDOW_S
from tests.oracle_pipeline.datasets.synthetic import DELAY_S, MODES, campaign


@pytest.fixture(scope="module")
def recorded():
    features, windows, _ = campaign(8, effect=20.0, modes=MODES)
    return MeasuredRuns.ordered(features, windows)


@pytest.fixture(scope="module")
def unusual(recorded):
    return unusual_windows(recorded)


def of_mode(runs, mode):
    return (runs.features["mode"] == mode).to_numpy()[runs.run]


def test_windows_are_unusual_from_the_onset_of_an_attack_on(recorded, unusual):
    attacked = of_mode(recorded, "delayed_fakeobject")
    outside = unusual.distance > unusual.usual
    after = unusual.start_s + WINDOW_S > DELAY_S
    column = list(unusual.families).index("contextual")
    assert outside[attacked & after, column].mean() > 0.95
    assert outside[attacked & ~after, column].mean() < 0.5
    assert set(unusual.farthest[attacked & after, column]) == {"contextual.yaw_variance"}


def test_at_most_one_normal_window_in_twenty_is_outside_in_a_family(recorded, unusual):
    normal = ~recorded.malicious[recorded.run]
    share = (unusual.distance[normal] > unusual.usual).mean(axis=0)
    assert (share <= 0.05 + 1.0 / normal.sum()).all()  # a twentieth is no whole number
    assert (share > 0.01).all()


def test_no_distance_exceeds_the_clip_of_scaled_features(unusual):
    assert np.nanmax(unusual.distance) <= CLIP


def test_a_run_does_not_affect_its_own_usual_range(recorded, unusual):
    block = recorded.block == 3
    rows = block[recorded.run]
    windows = recorded.windows.copy()
    windows.loc[rows, "structural.entropy"] += 5.0
    shifted = unusual_windows(MeasuredRuns(recorded.features, windows, recorded.run))
    column = list(unusual.families).index("structural")
    assert (shifted.distance[rows, column] > 10.0).all()


def test_two_blocks_of_normal_runs_are_too_few_for_windows():
    features, windows, _ = campaign(2)
    assert unusual_windows(MeasuredRuns.ordered(features, windows)) is None


def test_a_run_is_compared_with_normal_runs_of_other_blocks_as_its_evidence_is(recorded):
    features = recorded.features
    found = deviations_of_runs(features)
    assert set(found) == set(features["run_id"])
    row = features.iloc[[4]]
    beside = evidence(FeatureTables(row, recorded.windows[recorded.run == 4]), features)
    assert [each.feature for each in beside] == [d.feature for d in found[row["run_id"].iloc[0]]][
        : len(beside)
    ]
