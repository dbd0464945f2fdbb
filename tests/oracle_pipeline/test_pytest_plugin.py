"""A stranger's tests use the fixture ``behaviour``: it passes, fails with a reason, or raises."""

from pathlib import Path

import pytest

from tests.recorded_runs import RecordedRuns

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.slow
TESTS = """
import pytest

pytestmark = pytest.mark.behaviour(far=0.25)

def test_normal(behaviour):
    assert behaviour.normal({normal!r})

def test_attacked(behaviour):
    assert behaviour.normal({normal!r}, {attacked!r})

@pytest.mark.behaviour(far=0.001)
def test_rate_that_the_card_cannot_support(behaviour):
    assert not behaviour.normal({attacked!r})

@pytest.mark.behaviour(reference="none.card")
def test_another_card(behaviour):
    assert behaviour.normal({normal!r})
"""


def test_a_test_passes_or_fails_with_the_sentence_and_never_without_a_verdict(
    pytester: pytest.Pytester, recorded_run: RecordedRuns, normal_card: Path
):
    (pytester.path / "robot.card").symlink_to(normal_card)
    pytester.makeini("[pytest]\nbehaviour_reference = robot.card\n")
    runs = {
        "normal": str(recorded_run("lidar_passthrough", 5).path),
        "attacked": str(recorded_run("random_noise").path),
    }
    pytester.makepyfile(TESTS.format(**runs))
    options = ("-p", "oracle_pipeline.pytest_plugin", "--strict-markers", "-vv")
    result = pytester.runpytest_inprocess(*options)
    result.assert_outcomes(passed=1, failed=3)
    result.stdout.fnmatch_lines_random(
        [
            f"*assert ANOMALOUS  {runs['attacked']}: *normal runs*",
            "*Captured behaviour call*",
            "*OracleError: NO VERDICT*Too few normal runs*",
            "*There is no reference card*none.card*",
        ]
    )
