"""Every file below ``hostile/`` is refused where its first lines say, and nothing in it is run.

Payloads that are evaluated would leave a file named ``evaluated`` in the working directory.
"""

from pathlib import Path

import pytest

from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.scenario import ScenarioError, load_scenarios

CORPUS = sorted(Path(__file__).parent.joinpath("hostile").glob("*.yaml"))

HARMLESS = """\
schema: mutant/v1
id: harmless
label: normal
main: {type: sensor_msgs/msg/LaserScan, input: /scan, output: /scan_fuzzed}
transform:
  actions:
    - name: rest
      when: msg.range_min > 0
      do: [{drop: {}}]
"""


def programs(path):
    """What a file compiles to."""
    return [compile_scenario(scenario) for scenario in load_scenarios(path)]


def test_the_corpus_is_as_large_as_it_should_be():
    assert len(CORPUS) >= 60


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.stem)
def test_a_hostile_scenario_is_refused_where_it_is_hostile_and_not_evaluated(
    path, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    expected = path.read_text("utf-8").split("\n")[1].removeprefix("# refused: ")
    with pytest.raises(ScenarioError) as refusal:
        programs(path)
    assert str(refusal.value).startswith(f"{path}{expected}")
    assert not list(tmp_path.iterdir())


def test_the_harmless_base_of_the_corpus_is_accepted(tmp_path):
    path = tmp_path / "harmless.yaml"
    path.write_text(HARMLESS)
    (program,) = programs(path)
    assert program.scenario.id == "harmless"


@pytest.mark.parametrize("text", [HARMLESS + "# " + "a" * 2**20, HARMLESS + "---\n" * 2**17])
def test_a_file_of_many_bytes_is_refused(tmp_path, text):
    path = tmp_path / "large.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match="large.yaml: expected at most [0-9]+ bytes"):
        load_scenarios(path)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "binary.yaml"
    path.write_bytes(HARMLESS.encode() + b"\xff\xfe")
    with pytest.raises(ScenarioError, match="binary.yaml: .* Give a YAML file in UTF-8"):
        load_scenarios(path)
