"""``scenario check`` reports all faults of a file at once, from all stages."""

import re

import pytest

from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.diagnosis import diagnose
from sim.fuzzing.program import Program
from sim.fuzzing.scenario import ScenarioError, load_scenarios
from sim.scenarios import builtin_scenarios

GOOD = """\
schema: mutant/v1
id: tried
label: malicious
main: {type: sensor_msgs/msg/LaserScan, input: /scan_tom, output: /scan_fakeobject}
parameters:
  factor: {type: float, default: 1.05, min: 1.0, max: 1.5}
activation:
  onset: {after: start, seconds: 5}
transform:
  match: all
  actions:
    - name: stretch
      when: p.factor > 1.0
      do:
        - scale: {field: ranges, by: p.factor}
        - add: {field: angle_min, by: 0.1}
    - name: shift
      do:
        - add: {field: ranges, by: 0.1}
"""
FAULTS = {  # by stage: what is written, what instead, and where the fault is then
    "structure": ("after: start", "after: begin", 8),
    "unknown key": ("schema: mutant/v1", "schema: mutant/v1\ncolour: red", 2),
    "range": ("default: 1.05", "default: 7.0", 6),
    "type": ("when: p.factor > 1.0", "when: p.factor", 13),
    "reference": ("field: ranges, by: p.factor", "field: rangs, by: p.factor", 15),
    "expression": ("angle_min, by: 0.1", "angle_min, by: 0.1 +", 16),
    "operator": ("- add: {field: ranges", "- ad: {field: ranges", 19),
}


def faulty_lines(tmp_path, text):
    """Return the lines with faults."""
    file = tmp_path / "tried.yaml"
    file.write_text(text, "utf-8")
    (found,) = diagnose(file)
    assert isinstance(found, ScenarioError)
    return [int(re.search(r"tried.yaml:(\d+):", line)[1]) for line in str(found).splitlines()]


def test_a_fault_of_each_stage_is_reported_with_its_line(tmp_path):
    text = GOOD
    for old, new, _ in FAULTS.values():
        assert old in text
        text = text.replace(old, new, 1)
    lines = [line + (line > 2) for *_, line in FAULTS.values()]
    assert faulty_lines(tmp_path, text) == sorted(lines)


@pytest.mark.parametrize("stage", FAULTS)
def test_one_fault_is_reported_once_without_consequences(tmp_path, stage):
    old, new, line = FAULTS[stage]
    assert faulty_lines(tmp_path, GOOD.replace(old, new, 1)) == [line]


def test_a_reference_to_a_faulty_part_is_no_fault(tmp_path):
    assert faulty_lines(tmp_path, GOOD.replace("type: float", "type: length", 1)) == [6]
    let = "      let: {more: p.factor +}\n      do:\n        - add: {field: range_min, by: more}\n"
    assert faulty_lines(tmp_path, f"{GOOD}    - name: last\n{let}") == [21]


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("label: malicious", 'label: "malicious', 3, "not closed"),
        ("output: /scan_fakeobject}", "output: /scan_fakeobject", 4, "not closed"),
        ("  onset:", "\tonset:", 8, "a tab"),
    ],
)
def test_faults_are_reported_beside_lines_that_are_not_yaml(tmp_path, old, new, line, words):
    text = GOOD.replace(old, new, 1).replace("default: 1.05", "default: big", 1)
    lines = faulty_lines(tmp_path, text)
    assert lines[0] == line
    (found,) = diagnose(tmp_path / "tried.yaml")
    assert words in str(found).splitlines()[0]
    assert line == 4 or 6 in lines, "without the main topic, nothing else can be checked"


def test_a_correct_file_has_the_programs_that_compilation_gives(tmp_path):
    file = tmp_path / "tried.yaml"
    file.write_text(f"{GOOD}---\n{GOOD.replace('tried', 'again')}", "utf-8")
    programs = list(diagnose(file))
    assert all(isinstance(program, Program) for program in programs)
    assert [program.cost for program in programs] == [
        compile_scenario(scenario).cost for scenario in load_scenarios(file)
    ]


@pytest.mark.parametrize("name", sorted(builtin_scenarios())[::8])
def test_any_part_removed_from_a_built_in_scenario_is_reported(tmp_path, name):
    import yaml

    text = yaml.safe_dump(dict(builtin_scenarios()[name].document), sort_keys=False)
    for cut in range(len(text) // 7, len(text), len(text) // 7):
        file = tmp_path / f"{cut}.yaml"
        file.write_text(text[:cut], "utf-8")
        for found in diagnose(file, allow_actuation=True):
            assert isinstance(found, ScenarioError | Program)
