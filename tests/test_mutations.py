"""Mutants of the program: one change each, drawn by seed, in a copy of the code."""

import ast
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from oracle_pipeline.bags.sources import ROOT
from sim.software import run_code
from sim.turtlebot3.testbed import TURTLEBOT3
from tools.bench.kill_table import CHANGED, EFFECT, EQUAL, ORACLES, UNMUTATED, kill_table, named
from tools.bench.mutations import OPERATORS, drawn, mutants, mutated
from tools.bench.program_mutants import BLOCKS, EACH, TABLE, sources, write_tree

SOURCES = sources()
DRAWN = drawn(SOURCES, EACH, np.random.default_rng(0))


@pytest.mark.parametrize("mutant", DRAWN, ids=lambda mutant: mutant.name)
def test_a_mutant_compiles_and_differs_in_one_place(mutant):
    before = ast.unparse(ast.parse(SOURCES[mutant.module]))
    after = ast.unparse(mutated(SOURCES[mutant.module], mutant))
    compile(after, mutant.module, "exec")
    lines = zip(before.splitlines(), after.splitlines(), strict=True)
    (changed,) = ((old, new) for old, new in lines if old != new)
    assert mutant.before in changed[0]
    assert mutant.after in changed[1]


def test_the_same_seed_gives_the_same_mutants_and_another_one_others():
    assert drawn(SOURCES, EACH, np.random.default_rng(0)) == DRAWN
    assert drawn(SOURCES, EACH, np.random.default_rng(1)) != DRAWN


def test_mutants_are_different_and_spread_over_operators_and_modules():
    assert len({mutant.name for mutant in DRAWN}) == len(DRAWN) == EACH * len(OPERATORS)
    assert len({mutant.module for mutant in DRAWN}) > 12


@pytest.mark.parametrize(
    ("source", "changes"),
    [
        ("x = 0.5", {"constant": ["1.0", "0.25"]}),
        ("x = 3", {"constant": ["4", "2"]}),
        ("x = 100", {"constant": ["200", "50"]}),
        ("x = True", {"constant": ["False"]}),
        ("x = a + b", {"sign": ["a - b"]}),
        ("x = -a", {"sign": ["a"]}),
        ("x = a < b", {"condition": ["a >= b", "a <= b"]}),
        ("x = a and b", {"condition": ["a or b"]}),
        ("x = not a", {"condition": ["a"]}),
        ("x = b if a() else c", {"condition": ["b if not a() else c"]}),
        ("a[0] += b", {"sign": ["a[0] -= b"], "dropped": ["pass"]}),
        ('def f(a: "Literal[1]" = a[1]): raise E(1)', {}),
    ],
)
def test_an_operator_offers_these_changes(source, changes):
    found = {}
    for mutant in mutants("m", source):
        found.setdefault(mutant.operator, []).append(mutant.after)
    assert found == changes


def test_a_stale_value_comes_one_update_late_and_a_dropped_one_never():
    source = (
        "class Node:\n"
        "    def __init__(self):\n"
        "        self.value = start\n"
        "    def update(self, value):\n"
        "        self.value = value\n"
    )
    seen = {}
    for mutant in mutants("m", source):
        scope = {"start": 0}
        exec(compile(mutated(source, mutant), "m", "exec"), scope)  # noqa: S102 -- a mutant
        node = scope["Node"]()
        seen[mutant.operator] = [(node.update(value), node.value)[1] for value in (1, 2, 3)]
    assert seen == {"stale": [0, 1, 2], "dropped": [0, 0, 0]}


@pytest.mark.slow
def test_a_mutant_is_loaded_from_a_copy_and_the_original_stays(tmp_path):
    mutant = next(each for each in DRAWN if each.module == "sim.nav2.velocity_smoother")
    before = run_code([TURTLEBOT3.made_by])
    write_tree(mutant, tmp_path)
    shown = "import sim.nav2.velocity_smoother as module; print(module.__file__)"
    place = subprocess.run(
        [sys.executable, "-c", shown], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout.strip()
    assert place == str(tmp_path / "sim" / "nav2" / "velocity_smoother.py")
    assert sources() == SOURCES
    assert run_code([TURTLEBOT3.made_by]) == before != run_code([TURTLEBOT3.made_by], tmp_path)


@pytest.mark.slow
def test_machine_code_is_kept_only_of_what_does_not_depend_on_the_mutant(tmp_path):
    mutant = next(each for each in DRAWN if each.module == "sim.nav2.dwb_sampling")
    write_tree(mutant, tmp_path)
    ours, copied = (
        {code.name.partition(".")[0] for code in root.glob("sim/nav2/__pycache__/*.nbi")}
        for root in (ROOT, tmp_path)
    )
    assert copied == ours - {"dwb", "dwb_critics", "dwb_sampling"}


def run(mutant, operator, block, state, card):
    return {
        "mutant": mutant, "operator": operator, "block": block, "state": state,
        "what": "driven_m +2" if state == EFFECT else np.nan,
        **dict.fromkeys(ORACLES, np.nan), "card": card,
    }  # fmt: skip


def test_rates_are_of_runs_with_other_messages_and_equivalent_mutants_are_named():
    runs = pd.DataFrame(
        [
            run(UNMUTATED, np.nan, 0, EQUAL, np.nan),  # of the reference
            *(run(UNMUTATED, np.nan, block, EQUAL, block == 1) for block in (1, 2)),
            run("a", "sign", 1, CHANGED, True),
            run("a", "sign", 2, EQUAL, np.nan),
            run("b", "sign", 1, EFFECT, False),
            run("c", "stale", 1, EQUAL, np.nan),
        ]
    ).astype(dict.fromkeys(ORACLES, float))
    rows = {row.split(" | ")[0].strip("| "): row for row in kill_table(runs)}
    assert rows["sign"].startswith("| sign | 2 | 0 | 0 | 2 | n/a |")
    assert "| 0.50 [" in rows["sign"]
    assert rows["stale"].startswith("| stale | 1 | 0 | 1 | 0 | n/a |")
    assert rows["none"].startswith("| none | | | | 2 | n/a |")
    assert "| 0.50 [" in rows["none"]
    equivalent, _, missed = named(runs)
    assert "`c`" in equivalent
    assert "`a`" not in equivalent
    assert "`b` (driven_m +2)" in missed


def test_the_published_matrix_has_every_operator_and_mutant():
    runs = pd.read_csv(TABLE)
    mutated_runs = runs[runs["mutant"] != UNMUTATED]
    assert set(mutated_runs["operator"]) == set(OPERATORS)
    assert (mutated_runs.groupby("mutant").size() == BLOCKS).all()
