import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.oracles.invariants import HEAD, Invariants, half_to_learn
from oracle_pipeline.oracles.kind import Material, TracedRuns
from oracle_pipeline.oracles.registry import build_kinds
from oracle_pipeline.oracles.requirements import (
    NAV2,
    Requirement,
    RequirementError,
    dump,
    load,
    violations,
)
from oracle_pipeline.oracles.traces import SIGNALS, STEP_S, TIME
from tests.oracle_pipeline.oracles.made_runs import campaign, trace

numbers = st.floats(-2.0, 2.0, width=32)
samples = st.lists(st.tuples(numbers, numbers), min_size=1, max_size=60)


def of_two(pairs):
    first, second = np.array(pairs, dtype=np.float64).T
    columns = {name: np.full(len(pairs), np.nan) for name in SIGNALS}
    columns |= {TIME: STEP_S * np.arange(len(pairs)), "speed": first, "command_speed": second}
    return pd.DataFrame(columns)


def margin(formula, pairs):
    row = violations([Requirement("it", formula)], of_two(pairs))
    return -row[0]


def test_a_file_as_large_as_the_invariants_of_a_flight_controller_is_read(tmp_path):
    path, known = tmp_path / "invariants.yaml", Requirement("it", "always (speed <= 1)")
    path.write_text(dump([known], "\n".join([98 * "x"] * 40_000)), "utf-8")
    assert load(path) == [known]


@given(samples)
def test_robustness_is_the_smallest_margin_of_any_sample(pairs):
    speed, command = np.array(pairs, dtype=np.float64).T
    assert margin("always (speed <= 1)", pairs) == pytest.approx((1.0 - speed).min())
    expected = np.maximum(1.0 - speed, command).max()
    assert margin("eventually (speed <= 1 or command_speed >= 0)", pairs) == pytest.approx(expected)


@given(samples)
def test_a_command_held_for_half_a_second_must_be_followed(pairs):
    speed, command = np.array(pairs, dtype=np.float64).T
    steps = round(0.5 / STEP_S)
    held = np.array([(command[max(0, n - steps) : n + 1] - 0.1).min() for n in range(len(speed))])
    expected = np.maximum(-held, speed - 0.05).min()
    found = margin("always (historically[0, 0.5] (command_speed >= 0.1) -> speed >= 0.05)", pairs)
    assert found == pytest.approx(expected)


def test_violations_are_in_scales_and_nan_where_a_signal_is_not_recorded():
    fast = Requirement("fast", "always (speed <= 1)", 0.5)
    unknown = Requirement("unknown", "always (turn <= 1)")
    row = violations([fast, unknown], of_two([(2.0, 0.0)]))
    assert row[0] == pytest.approx(2.0)
    assert np.isnan(row[1])


def test_a_normal_patrol_satisfies_the_shipped_requirements():
    assert violations(load(NAV2), trace(0)).max() < 0.0


@pytest.mark.parametrize(
    ("altered", "name"),
    [
        ({"command_speed": 0.3}, "speed_within_limits"),
        ({"nearest_min": -0.4}, "clearance_above_footprint"),
        ({"speed": -0.3}, "moves_when_commanded"),
        ({"goals_failed": 1.0}, "goals_reached"),
        ({"gyro_turn": 0.5}, "inertia_agrees_with_odometry"),
        ({"nearest_max": 0.5}, "scanners_agree"),
    ],
)
def test_the_shipped_requirements_detect(altered, name):
    shipped = load(NAV2)
    row = violations(shipped, trace(0, **altered))
    broken = {each.name for each, beyond in zip(shipped, row, strict=True) if beyond > 0.0}
    assert name in broken


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["requirements: 3"], "'requirements' must be a list"),
        (["requirements: []", "learned_from: 3"], "'learned_from' must be a list"),
        (["requirements: []", "learnt: []"], "unknown key 'learnt'"),
        (["requirements: []", "signals: [a]"], "'signals' must be a mapping"),
        (["requirements: []", "signals: {speed: /a/b}"], "'speed' cannot name a signal"),
        (["requirements: []", "signals: {speed_rate: /a/b}"], "'speed_rate' cannot name"),
        (["requirements: []", "signals: {a-b: /a/b}"], "'a-b' cannot name a signal"),
        (["requirements: []", "signals: {a: voltage}"], "'a' must be a topic and a field"),
        (["requirements:", "  - {name: a, formula: always (volt > 1)}", "signals: {voltage: /a/b}"],
         "line 2: there is no signal 'volt'; did you mean voltage"),
        (["rules: []"], "'requirements' as its first key"),
        (["requirements: [&a {name: x}, *a]"], "alias"),
        (["requirements:", "  - {name: a, formula: always (sped > 0)}"],
         "line 2: there is no signal 'sped'; did you mean speed"),
        (["requirements:", "", "  - {name: a, formula: [speed"], "is not a file"),
        (["requirements:", "", "  - {name: a, formula: 'always (speed > '}"],
         "line 3: 'always .speed > ' is not a formula: parse error at line 1, column"),
        (["requirements:", "  - {name: a, formula: always (speed > 0), scale: 0}"],
         "'scale' must be a number above 0, found 0"),
        (["requirements:", "  - {name: a, formla: always (speed > 0)}"], "unknown key 'formla'"),
        (["requirements:", "  - {name: a, formula: always (speed > 0)}",
          "  - {name: a, formula: always (speed < 1)}"], "line 3: the name 'a' is used twice"),
        (["requirements:", "  - {name: a, formula: 'P>=0.9 (speed > 0)'}"], "cannot be evaluated"),
        (["requirements:", "  - {name: a, formula: __import__('os').system('true')}"],
         "line 2: .* is not a formula"),
    ],
)  # fmt: skip
def test_an_error_has_file_line_and_reason(tmp_path, lines, said):
    path = tmp_path / "rules.yaml"
    path.write_text("\n".join(lines), "utf-8")
    with pytest.raises(RequirementError, match=said) as caught:
        load(path)
    assert str(path) in str(caught.value)


def test_learned_invariants_are_equivalent_as_a_file_of_requirements(tmp_path):
    runs = campaign(6, nearest_max=0.4)
    learned = Invariants().learn(runs.where(runs.normal))
    path = tmp_path / "invariants.yaml"
    path.write_text(dump(learned.requirements(), HEAD), "utf-8")
    read = load(path)
    assert read == learned.requirements()
    by_formula = np.array([np.nanmax(violations(read, trace)) for trace in runs.traces])
    # Bounds in the file have four decimals, and are weaker than those learned by at most that.
    least = min(each.scale for each in read)
    assert by_formula == pytest.approx(learned.score(runs), abs=2e-4 / least)


@pytest.mark.parametrize("size", [1e-5, 1.0, 1e5])
def test_invariants_of_further_signals_are_equivalent_as_a_file_too(size, tmp_path):
    runs = campaign(6)
    draw = np.random.default_rng(0).normal
    traces = [trace.assign(torque=draw(size=len(trace)) * size) for trace in runs.traces]
    runs = TracedRuns(runs.table, tuple(traces))
    learned = Invariants().learn(runs.where(runs.normal))
    path, signals = tmp_path / "invariants.yaml", {"torque": "/joint_states/effort[0]"}
    path.write_text(dump(learned.requirements(), HEAD, signals=signals), "utf-8")
    read = load(path)
    assert (list(read), read.signals) == (learned.requirements(), signals)
    of_signal = [each for each in read if "torque" in each.formula]
    assert len(of_signal) == 4  # its bounds, and those of its rate
    for usual in runs.where(runs.normal).traces:
        assert violations(of_signal, usual).max() <= 0.0
        assert violations(of_signal, usual.assign(torque=-20.0 * size)).max() > 1.0


def test_recordings_that_invariants_were_learned_from_do_not_calibrate_them(tmp_path):
    runs = campaign(12)
    normal = runs.where(runs.normal)
    half = half_to_learn(normal)
    assert half.sum() == (~half).sum()
    seen, others = normal.where(half), normal.where(~half)
    path = tmp_path / "invariants.yaml"
    path.write_text(dump(Invariants().learn(seen).requirements(), HEAD, seen.digests()), "utf-8")
    material, note = Material(runs, load(path)).not_learned_from()
    assert note == "18 recordings are left out: the requirements were learned from them."
    assert list(material.runs.table["run_id"][material.runs.normal]) == list(others.table["run_id"])
    (of_file,) = (kind for kind in build_kinds(material) if kind.name == "specified")
    # No run breaks a bound that was learned from it; some of the other runs do.
    assert of_file.score(seen).max() <= 1e-3 < of_file.score(others).max()
    material, note = Material(seen, load(path)).not_learned_from()
    assert (list(material.requirements), "all 18 normal recordings" in note) == ([], True)


def test_an_invariant_is_a_line_that_can_be_deleted(tmp_path):
    learned = Invariants().learn(campaign(6)).requirements()
    lines = dump(learned, HEAD).splitlines()
    path = tmp_path / "invariants.yaml"
    path.write_text("\n".join(lines[:-1]), "utf-8")
    assert load(path) == learned[:-1]
