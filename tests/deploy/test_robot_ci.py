"""The shell steps of the action, and of the job for GitLab, do what the page on CI promises."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from oracle_pipeline.features import build_manager
from oracle_pipeline.scoring.learning import learn
from oracle_pipeline.scoring.reference import read_reference
from sim.campaigns import Campaign
from tests.docs.pages import REPOSITORY
from tests.recorded_runs import RecordedRuns, linked

pytestmark = pytest.mark.slow(15)

ACTION = yaml.safe_load((REPOSITORY / "action.yml").read_text("utf-8"))
JOB = yaml.safe_load((REPOSITORY / "deploy/gitlab-ci.yml").read_text("utf-8"))[".behaviour"]
COUNT = 4  # recordings of each build: as few as show a difference at a level of 0.2
SHORT = Campaign(timeout_s=20.0)
GITHUB = {
    "github.server_url": "https://example.org",
    "github.repository": "team/robot",
    "github.run_id": "7",
    "github.event.pull_request.number": "3",
}


@pytest.fixture(scope="module")
def card(recorded_run: RecordedRuns, tmp_path_factory: pytest.TempPathFactory) -> Path:
    runs = [recorded_run("atc_normal", number, SHORT).path for number in range(COUNT)]
    card = tmp_path_factory.mktemp("learned") / "robot.card"
    learn(read_reference(runs, build_manager())).save(card)
    return card


@pytest.fixture
def workspace(recorded_run: RecordedRuns, card: Path, tmp_path: Path) -> Path:
    """A checkout with recordings of a pull request and of its target; gh notes how it is called."""
    for folder, mode in (("main", "atc_normal"), ("pr", "atc_ghost_static")):
        for number in range(COUNT):
            linked(recorded_run(mode, number, SHORT), tmp_path / folder)
    (tmp_path / "robot.card").symlink_to(card)
    (tmp_path / "bin").mkdir()
    gh = tmp_path / "bin" / "gh"
    gh.write_text('#!/bin/sh\necho "$@" > "$RUNNER/called"\n')
    gh.chmod(0o755)
    return tmp_path


def run(script: str, folder: Path, variables: dict[str, str]) -> subprocess.CompletedProcess[str]:
    path = [str(folder / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]]
    return subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", script],
        cwd=folder, env=os.environ | variables | {"PATH": os.pathsep.join(path)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def steps(folder: Path, **inputs: str) -> dict[str, subprocess.CompletedProcess[str]]:
    """Run the shell steps of the action after the installation, as GitHub does."""
    given = {name: each.get("default", "") for name, each in ACTION["inputs"].items()} | inputs
    known = {f"inputs.{name}": value for name, value in given.items()}
    known |= GITHUB | {"runner.temp": str(folder)}
    files = {"GITHUB_STEP_SUMMARY": str(folder / "summary.md"), "RUNNER": str(folder)}
    done = {}
    for step in ACTION["runs"]["steps"]:
        if "run" in step and step["name"] != "Install":
            variables = {
                name: re.sub(r"\$\{\{ *(\S+) *\}\}", lambda found: known[found[1]], value)
                for name, value in step["env"].items()
            }
            done[step["name"]] = run(step["run"], folder, files | variables)
    return done


def test_a_changed_build_is_annotated_compared_and_commented_on(workspace: Path) -> None:
    given = {"recordings": "pr", "reference": "robot.card", "baseline": "main"}
    done = steps(workspace, **given, far="0.25", level="0.2")
    judged = done["Judge"]
    assert judged.returncode == 1, judged.stderr
    annotations = judged.stdout.splitlines()[:-1]
    assert annotations
    assert all(re.match("::error title=Behaviour::[A-Z ]+  pr/", each) for each in annotations)
    assert f"{COUNT} anomalous in" in (workspace / "summary.md").read_text("utf-8")
    results = workspace / "behaviour"
    assert (results / "index.html").read_text("utf-8").count("<article>") == COUNT
    assert (results / "badge.svg").is_file()

    assert done["Compare"].returncode == 1, done["Compare"].stderr
    comment = (results / "comment.md").read_text("utf-8")
    assert comment.startswith("### The behaviour changed: `")
    assert comment.strip().endswith("https://example.org/team/robot/actions/runs/7")
    assert comment in (workspace / "summary.md").read_text("utf-8")
    assert (workspace / "called").read_text().startswith("pr comment 3 --body-file ")


def test_without_reference_and_baseline_nothing_is_done_and_a_folder_is_learned_from(
    workspace: Path,
) -> None:
    done = steps(workspace, recordings="pr")
    assert {each.returncode for each in done.values()} == {0}
    assert not list((workspace / "behaviour").iterdir())
    one = "main/runs/atc_normal/run000"
    learned = steps(workspace, recordings=one, reference="main", far="0.25")["Judge"]
    assert (workspace / "behaviour/normal.card").is_file()
    assert learned.returncode < 2, learned.stdout  # it has a verdict


def test_the_job_for_gitlab_leaves_the_same_files(workspace: Path) -> None:
    variables = {name: str(value) for name, value in JOB["variables"].items()}
    variables |= {"RECORDINGS": "pr", "REFERENCE": "robot.card", "BASELINE": "main"}
    variables |= {"FAR": "0.25", "LEVEL": "0.2"}
    make_folder = JOB["before_script"][1]
    done = run("\n".join([make_folder, *JOB["script"]]), workspace, variables)
    assert done.returncode == 1, done.stderr
    assert f"{COUNT} anomalous in" in done.stdout
    names = {each.name for each in (workspace / "behaviour").iterdir()}
    assert names == {"verdicts.xml", "index.html", "badge.svg", "compare.xml", "comment.md"}
