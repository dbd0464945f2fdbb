"""docs/reference/scenario-language.md is complete; its scenarios compile, its commands run."""

import re
import shlex
import shutil
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from sim.commands.main import main
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.functions import BUILTINS, CONSTANTS
from sim.fuzzing.operators import OPERATORS
from sim.fuzzing.scenario import parse_scenarios, schema

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "reference" / "scenario-language.md").read_text("utf-8")
FILE = "my_scenario.yaml"
SIMULATED = ("record", "fuzz", "grid")  # too long to run here; that they do, test_commands shows


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)


SCENARIOS = blocks("yaml")
COMMANDS = "".join(blocks("console")).splitlines()


@pytest.mark.parametrize("text", SCENARIOS)
def test_scenarios_of_the_page_are_right(text):
    for scenario in parse_scenarios(text.encode(), "docs/reference/scenario-language.md"):
        execute(compile_scenario(scenario), 1)


def test_commands_of_the_page_run_one_after_the_other(controls, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(controls, tmp_path / "data" / "runs" / "lidar_passthrough")
    Path(FILE).write_text(SCENARIOS[0])
    assert len(COMMANDS) > 5
    for line in COMMANDS:
        name, *words = shlex.split(line)
        assert name == "oracle-sim"
        if words[0] in SIMULATED:
            command = main.get_command(click.Context(main), words[0])
            command.make_context(words[0], words[1:])
            continue
        words, _, target = " ".join(words).partition(" > ")
        done = CliRunner().invoke(main, shlex.split(words))
        assert done.exit_code == 0, done.output
        if target:
            Path(target).write_text(done.output)


@pytest.mark.parametrize("builtin", BUILTINS.values(), ids=BUILTINS)
def test_every_function_is_there_as_it_is_called(builtin):
    assert f"`{builtin.usage}`" in PAGE


@pytest.mark.parametrize("name", [*OPERATORS, *CONSTANTS, *schema()["properties"]])
def test_every_operator_constant_and_key_is_there(name):
    assert f"`{name}`" in PAGE
