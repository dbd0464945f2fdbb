import numpy as np
import pytest

from oracle_pipeline.evaluation.estimate import NOTHING
from oracle_pipeline.evaluation.integrity_checks import IntegrityCheck
from oracle_pipeline.evaluation.open_claims import as_table, open_claims
from tests.oracle_pipeline.datasets.synthetic import CONTROLS, MODES, run_features


def check(name, status):
    return IntegrityCheck(name, status, NOTHING, "a sentence")


def first(df, *checks):
    return open_claims(df, checks)[0]


def test_a_campaign_that_supports_every_claim_has_no_open_claims():
    assert open_claims(run_features(runs=24), [check("hard_negatives_pass", "green")]) == []


@pytest.mark.parametrize(
    ("runs", "claim", "reason", "blocks"),
    [
        (3, "A false positive rate of 5%", "24 blocks; you have 9 recordings of 3", 24),
        (23, "A false positive rate of 5%", "Record 1 more blocks", 24),
    ],
)
def test_the_next_unsupported_rate_is_named_with_the_blocks_it_needs(runs, claim, reason, blocks):
    said = first(run_features(runs=runs))
    assert said.claim == claim
    assert reason in said.reason
    assert (said.modes, said.blocks) == (tuple(MODES), blocks)


def test_a_rate_is_supported_before_it_is_proven():
    df = run_features(runs=24).query("mode in ('lidar_passthrough', 'random_noise')")
    said = first(df)
    assert said.claim == "Proof that the rate is at most 5%"
    assert "a rate of 11.7%; 59 are needed" in said.reason
    assert said.blocks == 59


@pytest.mark.parametrize(
    ("label", "missing", "mode"),
    [("normal", "no malicious runs", "fake_object"), ("malicious", "no normal runs", "lidar_pa")],
)
def test_a_missing_class_is_to_be_recorded(label, missing, mode):
    (said,) = open_claims(run_features().query(f"label == '{label}'"), [])
    assert missing in said.reason
    assert any(name.startswith(mode) for name in said.modes)
    assert said.blocks == 15


def test_unsupported_checks_name_the_modes_to_record_and_failed_ones_name_none():
    df = run_features(runs=24)
    lacks = [check("hard_negatives_pass", "unsupported"),
             check("unaltered_runs_are_alike", "unsupported")]  # fmt: skip
    red = check("sessions_score_alike", "red")
    lacking, failed = open_claims(df, [*lacks, red])
    assert {"benign_*", "fake_object_shadow", *MODES} <= set(lacking.modes)
    assert lacking.blocks == 29  # without a false alarm these exclude a rate above 10 %
    assert "sessions score alike" in failed.reason
    assert failed.blocks == 0


def test_a_feature_without_a_value_is_named_if_robots_have_others_of_its_family():
    df = run_features(runs=24).assign(**{"structural.entropy": np.nan, "atc.nameless": np.nan})
    assert first(df).reason == "No run has structural.entropy."


def test_the_table_has_every_claim():
    table = as_table(open_claims(run_features(3, modes=MODES | CONTROLS), []))
    assert table["modes"].iloc[0].split() == [*MODES, *CONTROLS]
    assert len(as_table([])) == 0
