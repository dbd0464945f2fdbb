"""The compilation of a file is bounded, even if its expressions multiply."""

import pytest

from sim.fuzzing.compilation import compile_file, compile_scenario
from sim.fuzzing.compile_context import MAX_OPERATIONS, OperationBudget
from sim.fuzzing.expressions import MAX_OPERATIONS as MOST_OF_ONE_EXPRESSION
from sim.fuzzing.scenario import MAX_BYTES, ScenarioError, load_scenarios
from sim.modes import modes
from sim.scenarios import builtin_scenarios
from tests.sim.fuzzing.workbench import builtin

HEAD = """\
schema: mutant/v1
id: big{number}
label: malicious
main: {{type: sensor_msgs/msg/LaserScan, input: /scan_tom, output: /scan_fuzzed}}
"""


def balanced(parts):
    """Return a sum that is nested no deeper than it must be."""
    while len(parts) > 1:
        parts = [f"({'+'.join(parts[place : place + 2])})" for place in range(0, len(parts), 2)]
    return parts[0]


def multiplying(number):
    """Return a scenario of 125 kB in which each of 2048 expressions calls a function of 1700."""
    functions = [f"  g{n}: {{params: [x], expr: '{balanced(['x'] * 200)}'}}" for n in range(60)]
    functions.append(f"  f0: {{params: [x], expr: '{balanced(['x'] * 120)}'}}")
    seven = balanced([f"fn.f0(x+{n})" for n in range(7)])
    functions.append(f"  f1: {{params: [x], expr: '{seven}'}}")
    let = ", ".join(f"v{n}: 'fn.f1({n}.5+msg.range_min)'" for n in range(32))
    actions = [f"    - {{name: a{n}, let: {{{let}}}, do: []}}" for n in range(64)]
    body = ["functions:", *functions, "transform:", "  match: all", "  actions:", *actions]
    return HEAD.format(number=number) + "\n".join(body) + "\n"


@pytest.fixture
def multiplied(tmp_path):
    file = tmp_path / "multiplied.yaml"
    file.write_text("---\n".join(map(multiplying, range(2))))
    assert 187_000 < file.stat().st_size < MAX_BYTES
    return file


@pytest.mark.slow
def test_a_file_whose_expressions_multiply_is_refused_where_they_are_too_many(multiplied):
    budget = OperationBudget()
    first, _ = load_scenarios(multiplied)
    with pytest.raises(ScenarioError, match=rf"at most {MAX_OPERATIONS} operations in all"):
        compile_scenario(first, budget=budget)
    assert -MOST_OF_ONE_EXPRESSION <= budget.left < 0


def test_the_scenarios_of_a_file_share_its_bound(tmp_path):
    term = balanced(["msg.range_min"] * 60)  # 181 operations
    actions = ", ".join(f"{{name: a{n}, when: '{term} > 0', do: []}}" for n in range(16))
    body = f"transform: {{actions: [{actions}]}}\n"
    file = tmp_path / "shared.yaml"
    file.write_text("---\n".join(HEAD.format(number=number) + body for number in range(7)))
    assert len(list(compile_file(file))) == 7
    file.write_text("---\n".join(HEAD.format(number=number) + body for number in range(12)))
    compiled = []
    with pytest.raises(ScenarioError, match="operations in all expressions of the file"):
        compiled.extend(program.scenario.id for program in compile_file(file))
    assert 7 <= len(compiled) < 12


def test_all_built_in_scenarios_together_take_a_third_of_what_a_file_may():
    budget = OperationBudget()
    for scenario in builtin_scenarios().values():
        compile_scenario(scenario, allow_actuation=True, budget=budget)
    assert 0 < MAX_OPERATIONS - budget.left < MAX_OPERATIONS / 3
    assert builtin("fake_object").scenario.id in modes()
