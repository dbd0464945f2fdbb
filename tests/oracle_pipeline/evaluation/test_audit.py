import numpy as np
import pytest

from oracle_pipeline.datasets import feature_columns
from oracle_pipeline.evaluation import integrity_checks
from oracle_pipeline.evaluation.audit import audit, blocks_needed, exact_pairs
from oracle_pipeline.evaluation.judged_runs import JudgedRuns
from tests.oracle_pipeline.datasets.synthetic import campaign

RUNS = 15
FEATURE = "contextual.range_variance"


@pytest.fixture(scope="module")
def tables():
    """Return a campaign in which a shadow repeats its passthrough to the last digit."""
    features, windows, truth = campaign(RUNS)
    columns, indexed = feature_columns(features), features.set_index(["mode", "block"])
    for control, shadow in exact_pairs(features):
        indexed.loc[shadow, columns] = indexed.loc[control, columns].to_numpy()
    exact = features.assign(**{c: indexed[c].to_numpy() for c in columns})
    return exact, windows, truth


def marked(features, mode, by):
    """Return the features with one of them larger in all runs of a mode."""
    return features.assign(**{FEATURE: features[FEATURE] + by * (features["mode"] == mode)})


def test_equal_unaltered_runs_have_no_distinguishing_feature(tables):
    features, *_ = tables
    assert len(exact_pairs(features)) == 3
    assert audit(features).empty


@pytest.mark.parametrize(
    ("mode", "tells", "between"),
    [
        ("random_noise_shadow", "control", "lidar_passthrough and random_noise_shadow"),
        ("lidar_passthrough_odom", "mode", "lidar_passthrough and lidar_passthrough_odom"),
    ],
)
def test_a_feature_that_distinguishes_control_or_mode_is_listed(tables, mode, tells, between):
    found = audit(marked(tables[0], mode, 1e3))
    row = found[(found["tells"] == tells) & (found["between"] == between)].iloc[0]
    assert (row["feature"], row["differing"]) == (FEATURE, 1.0)
    assert set(found["feature"]) == {FEATURE}


def test_a_feature_that_distinguishes_sessions_is_listed(tables):
    features, *_ = tables
    day = features.assign(**{FEATURE: features[FEATURE] + 1e3 * features["session"]})
    found = audit(day)
    assert found[["feature", "tells"]].to_numpy().tolist() == [[FEATURE, "session"]]


def test_with_one_block_per_session_earlier_sessions_are_compared_with_later(tables):
    features = tables[0].assign(session=tables[0]["block"])
    assert audit(features).empty
    drifting = features.assign(**{FEATURE: features[FEATURE] + 1e3 * (features["session"] > 7)})
    found = audit(drifting)
    assert found[["feature", "between"]].to_numpy().tolist() == [
        [FEATURE, "earlier and later sessions"]
    ]


def test_differences_below_the_floor_do_not_count(tables):
    features, *_ = tables
    features.attrs["fields"] = {FEATURE: {"floor": "0.5", "unit": "m^2"}}
    assert audit(marked(features, "random_noise_shadow", 0.4)).empty
    assert not audit(marked(features, "random_noise_shadow", 0.6)).empty


def test_attacked_runs_are_ignored(tables):
    assert audit(marked(tables[0], "random_noise", 1e3)).empty


@pytest.mark.parametrize("features", [1, 5, 200, 1000])
def test_blocks_needed_is_the_smallest_sufficient_number(features):
    blocks = blocks_needed(features)
    assert 2.0 * 0.5**blocks * features <= 0.05 < 4.0 * 0.5**blocks * features


def test_the_check_is_red_for_a_distinguishing_feature_and_unsupported_with_few_blocks(tables):
    features, windows, truth = tables
    columns = feature_columns(features)

    def check(table):
        return integrity_checks.unaltered_runs_alike(JudgedRuns.of(table, windows, truth), columns)

    assert check(features).status == "green"
    red = check(marked(features, "random_noise_shadow", 1e3))
    assert (red.status, red.figure.value) == ("red", 1.0)
    assert FEATURE in red.sentence
    session = check(features.assign(**{FEATURE: features[FEATURE] + 1e3 * features["session"]}))
    assert session.status == "red"
    mode = marked(features, "lidar_passthrough_odom", 1e3)
    mode = marked(mode, "fake_object_shadow", 1e3)
    assert check(mode).status == "green"  # its counterpart is marked too
    alone = mode.replace({"mode": {"fake_object": "an_attack"}})
    alone["run_id"], result = mode["run_id"], check(alone)
    assert result.status == "red"
    assert "an_attack without" in result.sentence
    few = check(features[features["block"] < 3])
    assert few.status == "unsupported"
    assert np.isnan(few.figure.value)
