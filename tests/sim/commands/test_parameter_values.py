"""Parameters that are typed and swept."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from sim.commands.parameter_values import ParameterError, sweep, typed
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.scenario import ScenarioError
from sim.testbed import Mode
from tests.sim.fuzzing.workbench import scenario

MODE = Mode(
    scenario(
        """\
parameters:
  level: {type: float, default: 0.1, min: 0.0, max: 1.0}
  rays: {type: int, default: 3, min: 1, max: 5}
  open: {type: float, default: 2.0, min: 0.0}
  on: {type: bool, default: true}
  name: {type: string, default: abc, max_len: 4}
  x: {type: float, default: 0.0, min: -9.0, max: 9.0, drawn: object_x}
"""
    )
)
PROGRAM = compile_scenario(MODE.scenario)
levels = st.floats(0.001, 1.0)


@given(levels, levels, st.integers(2, 20), st.booleans())
def test_a_sweep_goes_from_end_to_end_in_equal_steps_or_ratios(low, high, count, is_log):
    low, high = (float(f"{end:.6g}") for end in sorted((low, high)))
    assume(high > 1.01 * low)
    values = sweep(MODE, f"level={low}:{high}:{count}{':log' if is_log else ''}").values
    assert values[0] == low
    assert values[-1] == high
    assert len(values) == count
    steps = np.diff(np.log(values) if is_log else values)
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.05, atol=2e-5)


def test_a_sweep_of_whole_numbers_has_each_of_them_once():
    assert sweep(MODE, "rays=1:5:9").values == (1, 2, 3, 4, 5)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("level", "expected name=low:high:count"),
        ("level=0:1", "expected name=low:high:count"),
        ("level=0:1:2:cube", "expected name=low:high:count"),
        ("colour=0:1:2", "no parameter colour; it has level, rays"),
        ("name=0:1:2", "only numbers have sweeps"),
        ("level=0:1:0", "expected 1 to 1000 values, found 0"),
        ("level=0:1:2:log", "equal ratios need ends above 0"),
        ("level=0.5:2:2", "level: expected 0.0 to 1.0, found 2.0"),
        ("rays=0:5:2", "rays: expected 1 to 5, found 0"),
    ],
)
def test_a_sweep_that_cannot_be_is_refused(text, expected):
    with pytest.raises(ParameterError) as refused:
        sweep(MODE, text)
    assert expected in str(refused.value)


def test_words_become_values_of_the_parameters_type():
    program = compile_scenario(MODE.scenario)
    words = ["level=.5", "rays=2", "on=false", "name=a=b"]
    values = typed(program, words)
    assert values == {"level": 0.5, "rays": 2, "on": False, "name": "a=b"}
    execute(program, 1, values)


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("level=much", "expected a number, found 'much'"),
        ("rays=2.5", "expected a whole number, found '2.5'"),
        ("on=1", "expected true or false, found '1'"),
        ("colour=red", "expected one of level, rays, open, on, name, x, found colour"),
    ],
)
def test_invalid_values_are_refused_at_the_start_of_the_run(word, expected):
    program = compile_scenario(MODE.scenario)
    with pytest.raises(ScenarioError) as refused:
        execute(program, 1, typed(program, [word]))
    assert expected in str(refused.value)


def test_a_word_without_a_value_is_refused():
    with pytest.raises(ParameterError, match="expected name=value, found 'level'"):
        typed(compile_scenario(MODE.scenario), ["level"])
