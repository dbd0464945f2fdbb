import re

import numpy as np
import pytest

from oracle_pipeline.evaluation.limits import limits
from tests.oracle_pipeline.datasets.synthetic import run_features


def said(df):
    return " ".join(limits(df))


def test_a_large_campaign_is_not_warned_about():
    assert limits(run_features(runs=20)) == []


@pytest.mark.parametrize(
    ("df", "warning"),
    [
        (
            run_features(runs=3),
            "9 normal runs cannot support any claim about a 5% false-alarm rate",
        ),
        (
            run_features(runs=15),
            "45 normal runs cannot show.*may still be 6.4%; 59 runs are needed",
        ),
        (run_features(runs=3), "All runs come from 3 blocks"),
        (run_features(runs=1), "from one session"),
        (run_features().query("label == 'normal'"), "There are no malicious runs"),
        (run_features().query("label == 'malicious'"), "There are no normal runs"),
        (run_features().assign(**{"structural.entropy": np.nan}), "value for structural.entropy"),
    ],
)
def test_what_a_campaign_cannot_support_is_said(df, warning):
    assert re.search(warning, said(df))
