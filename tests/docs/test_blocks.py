"""Every command and every code block of the docs does what its page says.

A page is one session in a separate folder. Tutorials begin in an empty folder; the commands of
other pages find a small root, and bags, as their readers have. Blocks that name a file in their
first line are saved as that file. Simulations that take minutes are checked only, and so are
Dagster's commands: tests/test_commands.py runs those that the first tutorial shows.
"""

import contextlib
import json
import runpy
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner

from oracle_pipeline.cli import main as oracle
from oracle_pipeline.datasets import feature_columns, read_table, write_table
from sim.campaigns import Campaign, Options
from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.execution import execute
from sim.fuzzing.scenario import parse_scenarios
from tests.docs.pages import DOCS, LANGUAGES, PAGES, REPOSITORY, blocks, name
from tests.docs.shell import NOT_RUN, Shell
from tests.oracle_pipeline.datasets import synthetic
from tests.recorded_runs import ONE_GOAL, copied, linked

pytestmark = pytest.mark.slow

CHECKED = {"python", "sh", "toml", "yaml"}
RUN = [page for page in PAGES if any(block.language in CHECKED for block in blocks(page))]
NORMAL, ATTACKED = "lidar_passthrough", "fake_object"
LEARN = "oracle learn good_bags/ --output robot.card"  # on many pages: done once, by `reader`


@pytest.fixture(scope="module")
def lab(recorded_run, tmp_path_factory):
    """Five normal runs of one goal: the only simulation that all pages share."""
    root = tmp_path_factory.mktemp("recorded") / "lab"
    for number in range(5):
        linked(recorded_run(NORMAL, number), root)
    return root


@pytest.fixture(scope="module")
def reader(lab, recorded_run, tmp_path_factory):
    """A folder as the readers of how-to guides have it: a root with runs, and bags."""
    folder = tmp_path_factory.mktemp("reader")
    copied(recorded_run(ATTACKED), folder / "data")
    mirrored = replace(ONE_GOAL, options=Options(relation="mirrored"))
    copied(recorded_run(NORMAL, 0, mirrored), folder / "mirrored")
    shutil.copytree(lab / "runs" / NORMAL / "run000", folder / f"data/runs/{NORMAL}/run000")
    # As few as a verdict with --far 0.25, or a comparison, takes; of builds, short ones.
    for number in range(3):
        shutil.copytree(lab / f"runs/{NORMAL}/run00{number}/bag", folder / f"good_bags/{number}")
    for number in range(4):
        bag = recorded_run("atc_normal", number, Campaign(timeout_s=20.0)).bag
        for build in ("old_build", "new_build"):
            shutil.copytree(bag, folder / build / str(number))
    for place in ("my_robot_bag", "tonight/first"):
        shutil.copytree(lab / f"runs/{NORMAL}/run004/bag", folder / place)
    normal, attacked = (features(folder, mode) for mode in (NORMAL, ATTACKED))
    table = pd.concat([around(normal), attacked], ignore_index=True)
    table.attrs = dict(normal.attrs)
    write_table(table, folder / "data/datasets/features.parquet")
    with contextlib.chdir(folder):
        command(oracle, *LEARN.split()[1:])
    return folder


def command(group, *words):
    done = CliRunner().invoke(group, [str(word) for word in words])
    assert done.exit_code == 0, done.output


def features(folder, mode):
    run, table = folder / f"data/runs/{mode}/run000", folder / f"{mode}.parquet"
    command(oracle, "features", run, "--format", "parquet", "--output", table)
    return read_table(table)


def around(row: pd.DataFrame) -> pd.DataFrame:
    """Return 40 runs in 40 blocks, two floors of every feature around one."""
    columns = feature_columns(row)
    values = row[columns].to_numpy(float)
    table = pd.DataFrame(
        values * (1.0 + 0.02 * np.random.default_rng(0).normal(size=(40, len(columns)))),
        columns=columns,
    )
    table.insert(0, "run_id", [f"patrol|run{number:03d}" for number in range(40)])
    table.insert(1, "mode", "patrol")
    table.insert(2, "label", "normal")
    table.insert(3, "block", np.arange(40))
    table.insert(4, "session", np.arange(40) % 3)
    table.insert(5, "world", "hexagon-0")
    table["where"] = table["missing"] = "{}"
    table.attrs = dict(row.attrs)
    return table


@pytest.fixture
def folder(request, tmp_path, reader):
    """The folder in which the commands of a page run."""
    page = request.getfixturevalue("page")
    if page.parent.name != "tutorials":
        shutil.copytree(reader, tmp_path, dirs_exist_ok=True)
    elif page.stem == "reproduce-the-thesis":  # what its 90 runs would leave
        write_table(
            synthetic.run_features(runs=5), tmp_path / "data/thesis/datasets/features.parquet"
        )
    return tmp_path


@pytest.mark.parametrize("page", RUN, ids=name)
def test_the_blocks_of_a_page_run_one_after_the_other(page, folder, lab, monkeypatch):
    monkeypatch.chdir(folder)
    tutorial = page.parent.name == "tutorials"
    shell = Shell(folder, tutorial, lab, answers={} if tutorial else {LEARN: (0, "")})
    for block in blocks(page):
        if block.file:
            (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.file).write_text(block.text, "utf-8")
        check(block, shell)


def test_the_notebook_runs_from_top_to_bottom(reader, tmp_path, monkeypatch, capsys):
    shutil.copytree(reader, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((REPOSITORY / "examples/verdicts.ipynb").read_text("utf-8"))
    code = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    (tmp_path / "notebook.py").write_text("\n\n".join(code), "utf-8")
    names = runpy.run_path("notebook.py")
    assert names["verdicts"].outcome == names["verdicts"][0].outcome == "normal"
    assert "1 normal" in capsys.readouterr().out
    assert names["comparison"].outcome == "same"


def check(block, shell):
    if block.language == "sh":
        shell.run(block.text)
    elif block.language == "toml":
        tomllib.loads(block.text)
    elif block.language == "yaml" and "schema: mutant" in block.text:
        for scenario in parse_scenarios(block.text.encode(), f"line {block.line}"):
            execute(compile_scenario(scenario, allow_actuation=True), 1)
    elif block.language == "yaml":
        assert yaml.safe_load(block.text)
    elif block.language == "python" and block.file:
        compile(block.text, block.file, "exec")
    elif block.language == "python":
        script = shell.folder / f"line_{block.line}.py"
        script.write_text(block.text, "utf-8")
        runpy.run_path(str(script))


def test_every_block_states_its_language():
    for page in PAGES:
        assert {block.language for block in blocks(page)} <= LANGUAGES, page


def test_every_block_that_is_not_run_is_listed():
    words = {line.split()[0] for page in PAGES for block in blocks(page, "sh")
             for line in block.text.splitlines() if line.strip()}  # fmt: skip
    assert set(NOT_RUN) <= words


def test_there_are_five_tutorials_and_all_of_them_have_commands():
    tutorials = sorted((DOCS / "tutorials").glob("*.md"))
    assert len(tutorials) == 5
    assert all(blocks(page, "sh") for page in tutorials)
