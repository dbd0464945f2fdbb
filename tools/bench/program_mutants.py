"""Mutants of Nav2's nodes in closed loop: which oracles notice a defect of the robot's software.

``python -m tools.bench.program_mutants`` draws mutants of the modules in ``sim/nav2`` by seed (see
``mutations``). Each is a copy of ``sim`` with one node of one syntax tree changed, so its runs are
recorded as any others, and their manifests name other software. The first blocks without a mutant
are the reference; the following ones are run with and without mutants, three for each. A run whose
messages are equal to those of the unmutated run of its block, byte for byte, is no defect to be
found: such a mutant is equivalent on these runs. A mutant that raises an error or hangs leaves no
recording.

Each oracle judges at 5 %: five kinds as ``oracle kinds`` does, with runs in mirrored worlds and 20
answers, and a reference card as ``oracle score`` does (exit code 1). Unmutated runs of the same
blocks give the false positives.
"""

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
import pandas as pd

from assets.search.closed_loop import task_effects
from oracle_pipeline import learn, score
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.sources import ROOT, dependencies
from oracle_pipeline.bags.terminal import progress_bar
from oracle_pipeline.evaluation.card_verdicts import RATE
from oracle_pipeline.evaluation.kinds_comparison import compare_kinds
from oracle_pipeline.oracles.collecting import traced_runs
from oracle_pipeline.oracles.human import answered_by_labels
from oracle_pipeline.oracles.kind import RELATION, SAME, Material, TracedRuns
from oracle_pipeline.oracles.registry import build_kinds
from oracle_pipeline.oracles.requirements import NAV2, load
from oracle_pipeline.scoring.output import exit_code
from sim.pairs import CONTROL
from sim.software import run_code
from sim.turtlebot3.testbed import TURTLEBOT3
from sim.worker_pool import LIMIT
from tools.bench.kill_table import (
    CARD,
    CHANGED,
    DIFFERS,
    EFFECT,
    EQUAL,
    NONE,
    ORACLES,
    UNMUTATED,
    kill_table,
    named,
)
from tools.bench.mutations import Mutant, drawn, mutated

REFERENCE, TESTED, BLOCKS = 40, 39, 3  # blocks of the card, blocks with mutants, and of each mutant
SEED, EACH, QUESTIONS = 39, 12, 20
TIME_LIMIT_S = 120.0  # of a run; a normal one takes 1 to 3 s
# What Nav2's nodes do; not wiring, messages, lifecycles, and nodes that do nothing here.
MODULES = (
    "amcl", "behavior_server", "behavior_tree", "behavior_tree_leaves", "bt_navigator",
    "collision_monitor", "controller_server", "costmap", "costmap_layers", "costmap_node", "dwb",
    "dwb_critics", "dwb_sampling", "inflation", "laser", "likelihood_field", "navfn",
    "particle_filter", "paths", "planner_server", "rotation_shim", "velocity_smoother",
)  # fmt: skip
MIRRORED = "mirrored"
TABLE = ROOT / "docs" / "explanation" / "program_mutants.csv"


def sources(root: Path = ROOT) -> dict[str, str]:
    """Return the source code of all modules that are mutated, by dotted name."""
    folder = root / "sim" / "nav2"
    return {f"sim.nav2.{name}": (folder / f"{name}.py").read_text("utf-8") for name in MODULES}


def write_tree(mutant: Mutant, root: Path) -> None:
    """Write the packages that simulate, one module of them mutated.

    Machine code of numba is copied along, but not that of what depends on the module: functions
    are compiled together with those that they call.
    """
    (root / "oracle_pipeline").symlink_to(ROOT / "oracle_pipeline")
    shutil.copytree(ROOT / "sim", root / "sim")
    file = root.joinpath(*mutant.module.split(".")).with_suffix(".py")
    file.write_text(ast.unparse(mutated(file.read_text("utf-8"), mutant)), "utf-8")
    for code in list(root.glob("sim/**/__pycache__/*.nb?")):
        stem = code.name.partition(".")[0]
        module = ".".join([*code.parent.parent.relative_to(root).parts, stem])
        if file in dependencies([module], root=root):
            code.unlink()


def record(out: Path, blocks: range, *options: str, root: Path = ROOT) -> str:
    """Record normal runs with the code in a folder; return the errors of those that failed."""
    command = (
        "-c", "from sim.commands.main import main; main()", "record", "-m", CONTROL, "--goals", "1",
        "--seed", str(SEED), "-n", str(len(blocks)), "--first-block", str(blocks.start),
        "--out", str(out.resolve()), *options,
    )  # fmt: skip
    setting = {"PYTHONPATH": str(root), LIMIT: str(TIME_LIMIT_S), "XDG_CACHE_HOME": f"{root}/cache"}
    own = {} if root == ROOT else setting
    done = subprocess.run(
        [sys.executable, *command], cwd=root, env=os.environ | own, capture_output=True, text=True
    )
    return done.stderr.strip()


def record_mutant(mutant: Mutant, out: Path, blocks: range) -> str:
    """Record runs of a mutant, unless they are there; return the errors of those that failed."""
    with tempfile.TemporaryDirectory(prefix="oracle-") as folder:
        root = Path(folder)
        write_tree(mutant, root)
        code = run_code([TURTLEBOT3.made_by], root)
        if all((run := manifest(out, block)) and run.software.code == code for block in blocks):
            return ""
        shutil.rmtree(out, ignore_errors=True)  # of another mutant, or not complete
        return record(out, blocks, root=root)


def run_at(out: Path, block: int) -> RunDirectory:
    """Return the place of the run of a block."""
    return RunDirectory(out, CONTROL, block)


def manifest(out: Path, block: int) -> Manifest | None:
    """Return the manifest of the run of a block; None without a recording."""
    run = run_at(out, block)
    return run.manifest() if run.is_complete() else None


def recorded(out: Path, each: int) -> pd.DataFrame:
    """Record everything; return a row for each run without a mutant, and for each with one."""
    every = range(REFERENCE + TESTED)
    record(out / UNMUTATED, every)
    record(out / MIRRORED, every, "--relation", "mirrored")
    tested = [range(first, first + BLOCKS) for first in every[REFERENCE::BLOCKS]]
    tested = [blocks for blocks in tested if all(_is_complete(out, block) for block in blocks)]
    normal = [block for block in every[:REFERENCE] if _is_complete(out, block)]
    normal += [block for blocks in tested for block in blocks]
    rows = [{"mutant": UNMUTATED, "block": b, "state": EQUAL, "place": UNMUTATED} for b in normal]
    chosen = drawn(sources(), each, np.random.default_rng(SEED))
    for mutant, blocks in zip(progress_bar(chosen, unit="mutant"), cycle(tested)):
        place = f"mutants/{mutant.name}"
        failed = record_mutant(mutant, out / place, blocks).splitlines()
        known = {"mutant": mutant.name, "operator": mutant.operator, "place": place}
        known |= {"before": mutant.before, "after": mutant.after}
        rows += [known | outcome(out, place, block, failed) for block in blocks]
    return pd.DataFrame(rows)


def _is_complete(out: Path, block: int) -> bool:
    """Return whether a block was run without a mutant, and in a mirrored world."""
    return all(manifest(out / place, block) for place in (UNMUTATED, MIRRORED))


def outcome(out: Path, place: str, block: int, failed: Sequence[str]) -> dict[str, object]:
    """Return what a mutant does to the run of a block: its state, and the effect or the error."""
    ours, theirs, mirrored = (manifest(out / at, block) for at in (place, UNMUTATED, MIRRORED))
    if theirs is None or mirrored is None:
        raise LookupError(f"Block {block} has no unmutated run; record it first.")
    if ours is None:
        about = next((line for line in failed if f"run{block:03}" in line), "")
        return {"block": block, "state": NONE, "what": about.partition(": ")[2]}
    if ours.content_hash == theirs.content_hash:
        return {"block": block, "state": EQUAL}
    effects = task_effects(ours, theirs, [mirrored])
    counted = [f"{name} {by:+.2g}" for name, (by, steps) in effects.items() if abs(steps) >= 1.0]
    state = EFFECT if counted else CHANGED
    return {"block": block, "state": state, "what": ", ".join(counted)}


def judged(runs: pd.DataFrame, out: Path) -> pd.DataFrame:
    """Return the runs with a column for each oracle: whether it notices; NaN if it judged not."""
    runs = runs.assign(**dict.fromkeys(ORACLES, np.nan))
    places = zip(runs["place"], runs["block"], strict=True)
    paths = pd.Series([run_at(out / place, block).path for place, block in places], runs.index)
    normal, differs = runs["mutant"] == UNMUTATED, runs["state"].isin(DIFFERS)
    reference = normal & (runs["block"] < REFERENCE)

    new = differs | (normal & ~reference)
    verdicts = score(paths[new], learn(paths[reference]), far=RATE)
    runs.loc[new, CARD] = [float(exit_code([each]) == 1) for each in verdicts]

    known = differs | normal
    mirrored = [run_at(out / MIRRORED, block).path for block in runs["block"][normal]]
    called = by_kinds(runs[known], traced_runs([*paths[known], *mirrored]))
    runs.loc[known, called.columns] = called.to_numpy(dtype=np.float64)
    return runs


def by_kinds(runs: pd.DataFrame, traced: TracedRuns) -> pd.DataFrame:
    """Return whether each kind of oracle notices a run, by signals of these runs and mirrored ones.

    The answers are about runs without a mutant, and about those with an effect on the task.
    """
    is_same = (traced.table[RELATION] == SAME).to_numpy()
    ours, follow_ups = traced.where(is_same), traced.where(~is_same)
    label = runs["state"].map({EQUAL: "normal", CHANGED: "unknown", EFFECT: "malicious"})
    names = runs["mutant"] + "/" + runs["block"].astype(str)
    table = ours.table.assign(run_id=names.to_numpy(), label=label.to_numpy())
    ours = replace(ours, table=table)
    material = answered_by_labels(Material(ours, load(NAV2), {}, follow_ups), QUESTIONS)
    p = compare_kinds(build_kinds(material), ours, rate=RATE).p
    return p[p.columns.intersection([*ORACLES])] <= RATE


def main() -> None:
    """Record and judge all runs, write a row for each, and print the kill matrix."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--out", type=Path, default=Path("data/program_mutants"), help="Runs.")
    parser.add_argument("--table", type=Path, default=TABLE, help="CSV file to write.")
    parser.add_argument("--each", type=int, default=EACH, help="Mutants of each operator.")
    options = parser.parse_args()
    runs = judged(recorded(options.out, options.each), options.out).drop(columns="place")
    runs.to_csv(options.table, index=False)
    print("\n".join([*kill_table(runs), *named(runs)]))


if __name__ == "__main__":
    main()
