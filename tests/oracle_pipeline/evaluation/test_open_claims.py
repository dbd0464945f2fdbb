import pytest

from oracle_pipeline.evaluation.estimate import NOTHING
from oracle_pipeline.evaluation.integrity_checks import IntegrityCheck
from oracle_pipeline.evaluation.open_claims import COLUMNS, open_claims
from tests.oracle_pipeline.datasets.synthetic import MODES, run_features


def check(name, status):
    return IntegrityCheck(name, status, NOTHING, "a sentence")


def first(df, *checks):
    return open_claims(df, checks).iloc[0]


def rows(df, checks):
    return list(open_claims(df, checks).itertuples())


def test_a_campaign_that_supports_every_claim_has_no_open_claims():
    claims = open_claims(run_features(runs=24), [check("hard_negatives_pass", "green")])
    assert claims.empty
    assert tuple(claims.columns) == COLUMNS


@pytest.mark.parametrize(
    ("runs", "claim", "reason", "blocks"),
    [
        (3, "A false positive rate of 5%", "24 blocks; you have 3", 24),
        (23, "A false positive rate of 5%", "Record 1 more blocks", 24),
    ],
)
def test_the_next_unsupported_rate_is_named_with_the_blocks_it_needs(runs, claim, reason, blocks):
    said = first(run_features(runs=runs))
    assert said.claim == claim
    assert reason in said.reason
    assert (said.modes, said.blocks) == (" ".join(MODES), blocks)


@pytest.mark.parametrize(
    ("label", "missing", "mode"),
    [("normal", "no malicious runs", "fake_object"), ("malicious", "no normal runs", "lidar_pa")],
)
def test_a_missing_class_is_to_be_recorded(label, missing, mode):
    (said,) = rows(run_features().query(f"label == '{label}'"), [])
    assert missing in said.reason
    assert any(name.startswith(mode) for name in said.modes.split())
    assert said.blocks == 15


def test_checks_that_lack_runs_and_those_that_fail_are_named_apart():
    lacks = [check("hard_negatives_pass", "unsupported"),
             check("unaltered_runs_are_alike", "unsupported")]  # fmt: skip
    red = check("sessions_score_alike", "red")
    lacking, failed = rows(run_features(runs=24), [*lacks, red])
    assert lacking.reason.endswith("lack runs: hard negatives pass, unaltered runs are alike.")
    assert failed.reason.endswith("fail: sessions score alike.")
    assert lacking.blocks == failed.blocks == 0
