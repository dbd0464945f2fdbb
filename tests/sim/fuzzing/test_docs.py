"""docs/reference/scenario-language.md is complete; tests/docs runs its scenarios and commands."""

from pathlib import Path

import pytest

from sim.fuzzing.functions import BUILTINS, CONSTANTS
from sim.fuzzing.operators import OPERATORS
from sim.fuzzing.schema_words import schema

pytestmark = pytest.mark.slow

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "reference" / "scenario-language.md").read_text("utf-8")


@pytest.mark.parametrize("builtin", BUILTINS.values(), ids=BUILTINS)
def test_every_function_is_documented_with_its_usage(builtin):
    assert f"`{builtin.usage}`" in PAGE


@pytest.mark.parametrize("name", [*OPERATORS, *CONSTANTS, *schema()["properties"]])
def test_every_operator_constant_and_key_is_documented(name):
    assert f"`{name}`" in PAGE
