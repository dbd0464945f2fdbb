"""What a search looks for: an attack with a clear effect that is missed is the best."""

from hypothesis import given
from hypothesis import strategies as st

from assets.search.closed_loop import Finding, Proposal
from assets.search.search import evasion

effects = st.floats(0.0, 1e6) | st.just(float("inf"))


def finding(effect: float, score: float, *, is_passed: bool) -> Finding:
    return Finding(
        Proposal(0, 0, {}, {}), screened_out=False, effect=effect, effects={}, score=score,
        p_value=0.5, passed=is_passed, families=(), moved=(),
    )  # fmt: skip


passed = st.builds(finding, effects, st.floats(-2.0, 3.0), is_passed=st.just(True))
detected = st.builds(finding, effects, st.floats(3.0, 1e6), is_passed=st.just(False))


def dominates(ours: Finding, theirs: Finding) -> bool:
    (effect, score), (other_effect, other_score) = map(evasion, (ours, theirs))
    return effect >= other_effect and score <= other_score and (effect, score) != (
        other_effect, other_score,
    )  # fmt: skip


@given(detected, passed)
def test_a_missed_run_with_an_effect_is_preferred_to_detected_runs(
    caught: Finding, missed: Finding
) -> None:
    if missed.effect >= 3.0:
        assert dominates(missed, caught)
    assert not dominates(caught, missed)


@given(passed, passed)
def test_among_missed_runs_only_the_effect_counts(one: Finding, two: Finding) -> None:
    if min(one.effect, 3.0) > min(two.effect, 3.0):
        assert dominates(one, two)


@given(detected, st.floats(3.0, 1e6))
def test_a_robot_that_is_stuck_longer_has_no_better_value(caught: Finding, effect: float) -> None:
    stuck = finding(effect, caught.score, is_passed=False)
    assert not dominates(stuck, finding(3.0, caught.score, is_passed=False))
