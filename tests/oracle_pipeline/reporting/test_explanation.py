import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.datasets import feature_columns
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.reporting.explanation import counterpart, explanations
from oracle_pipeline.scoring.evidence import evidence
from oracle_pipeline.scoring.verdict import ScoringError
from oracle_pipeline.windows import WINDOW_S
from tests.oracle_pipeline.datasets.synthetic import ATTACKED, DELAY_S, campaign

RUNS = 6


@pytest.fixture(scope="module")
def tables():
    features, windows, _ = campaign(RUNS, effect=30.0)
    return features, windows


def judged(df, p=0.01):
    """Run 0 is the least, the last one the most anomalous; all are called so."""
    return df[["run_id", "mode", "label"]].assign(score=df["block"].astype(float), p=p)


def draw(run):
    return run.encode()


def test_the_detected_run_with_the_median_score_of_each_attack_is_explained(tables):
    runs = judged(tables[0])
    runs.loc[runs["score"] < 3.0, "p"] = 0.5
    assert [each.run_id for each in explanations(*tables, runs, draw)] == [
        "random_noise|run004", "fake_object|run004", "delayed_fakeobject|run004",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("p", "words"),
    [(0.05, "Called anomalous"), (0.051, "Not called anomalous"), (np.nan, "Not judged")],
)
def test_the_verdict_is_that_of_the_evaluation(tables, p, words):
    found = explanations(*tables, judged(tables[0], p), draw)
    assert len(found) == 3
    assert all(each.verdict.startswith(words) for each in found)


def test_the_evidence_has_the_features_that_the_attack_changed(tables):
    for each in explanations(*tables, judged(tables[0]), draw):
        assert {e.feature for e in each.evidence[:2]} == set(ATTACKED)
        assert not each.notes
    delayed = each.evidence[0]
    assert delayed.window_start_s + WINDOW_S > DELAY_S


def test_the_usual_range_is_that_of_normal_runs_of_other_blocks(tables):
    df, windows = tables
    run = "random_noise|run002"
    of_run = FeatureTables(df[df["run_id"] == run], windows[windows["run_id"] == run])
    found = {each.feature: each for each in evidence(of_run, df)}
    right = df[(df["label"] != "malicious") & (df["block"] != 2)]
    assert set(ATTACKED) <= set(found) <= set(feature_columns(df))
    for name, each in found.items():
        low, high = np.percentile(right[name], [5, 95])
        assert (each.usual_low, each.usual_high) == pytest.approx((low, high))
        assert not low <= each.value <= high


def test_without_a_normal_run_of_another_block_there_is_no_evidence_and_a_reason(tables):
    df, windows = tables
    alone = df[df["block"] == 0]
    row = alone[alone["mode"] == "fake_object"]
    with pytest.raises(ScoringError, match="no normal run of another block"):
        evidence(FeatureTables(row, windows[windows["run_id"] == "fake_object|run000"]), alone)
    for each in explanations(alone, windows, judged(alone), draw):
        assert each.evidence == ()
        assert "no normal run of another block" in each.notes[0]


def test_the_counterpart_of_a_run_is_its_control_of_the_same_block(tables):
    (_, found, _) = explanations(*tables, judged(tables[0]), draw)
    assert list(found.pictures) == ["fake_object|run002", "lidar_passthrough_odom|run002"]
    assert found.pictures["fake_object|run002"] == b"fake_object|run002"


def test_the_counterpart_of_other_attacks_is_the_shadow_or_the_first_normal_run_of_the_block():
    rows = [
        ("benign_slow", "normal", 1),
        ("held_shadow", "control", 1),
        ("quiet_sky", "normal", 2),
        ("quiet_sky", "normal", 1),
        ("still_sky", "normal", 1),
        ("ghost_shadow", "control", 2),
        ("benign_slow", "normal", 3),
    ]
    df = pd.DataFrame(
        {"run_id": f"{mode}|run{run:03d}", "mode": mode, "label": label}
        for mode, label, run in rows
    )
    assert counterpart("held|run001", df) == ["held_shadow|run001"]
    assert counterpart("ghost|run001", df) == ["quiet_sky|run001"]
    assert counterpart("held|run003", df) == []


def test_a_picture_that_cannot_be_drawn_is_a_note(tables):
    def no_bag(run):
        if run.startswith("fake_object"):
            raise OracleError("it has no bag")
        return b""

    (_, found, _) = explanations(*tables, judged(tables[0]), no_bag)
    assert list(found.pictures) == ["lidar_passthrough_odom|run002"]
    assert found.notes == ("fake_object|run002 is not drawn: it has no bag",)


def test_without_attacks_nothing_is_explained(tables):
    df, windows = tables
    right = df[df["label"] != "malicious"]
    assert explanations(right, windows, judged(right), draw) == []
