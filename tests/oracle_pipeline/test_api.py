"""The analysis from Python: wrong arguments are errors that say what is wrong."""

import math

import pytest

import oracle_pipeline
from oracle_pipeline.bags.errors import OracleError


def test_without_a_recording_there_is_nothing_to_learn_from_or_to_judge(normal_card):
    with pytest.raises(OracleError, match="No recording is given"):
        oracle_pipeline.learn([])
    with pytest.raises(OracleError, match="No recording is given"):
        oracle_pipeline.score([], normal_card)


@pytest.mark.parametrize("rate", [0.0, 1.0, 2.0, -0.1, math.nan])
def test_an_invalid_rate_is_refused(rate, normal_card, recorded_run):
    run = recorded_run("random_noise").path
    with pytest.raises(OracleError, match="between 0 and 1"):
        oracle_pipeline.score(run, normal_card, far=rate)
    with pytest.raises(OracleError, match="between 0 and 1"):
        oracle_pipeline.compare(run, run, level=rate)
