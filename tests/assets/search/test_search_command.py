"""``oracle-sim search`` in closed loop: it can be continued, and misses are scenarios."""

import dataclasses
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import optuna
import pytest
from click.testing import CliRunner, Result

from assets.oracle_sim import main as oracle_sim
from assets.search.attack_space import Attack
from assets.search.closed_loop import Finding, Proposal
from assets.search.composed_attacks import composed_attacks
from assets.search.outcome import misses, save
from assets.search.scenario_parameters import scenario_attacks
from assets.search.search import CONTROLS, SearchSettings
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from oracle_pipeline.datasets import feature_dataset, window_dataset
from oracle_pipeline.evaluation.campaign_evaluation import evaluate
from oracle_pipeline.evaluation.truth import truth_table
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.opened_run import open_run
from sim.campaigns import Campaign, Options
from sim.experiments import recipe_for
from sim.fuzzing.compilation import compile_file
from sim.modes import find_mode, modes
from sim.pairs import CONTROL
from tests.recorded_runs import RecordedRuns
from tools.scripts.found_attacks import place_of

pytestmark = pytest.mark.slow(5)

OF_SEARCH = Campaign(goals_per_run=1, timeout_s=120.0)  # the command's own limit


@pytest.fixture(scope="module")
def controls(normal_card: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The runs without an attack of a search of one block, with their repeats."""
    folder = tmp_path_factory.mktemp(CONTROLS)
    SearchSettings(str(normal_card), Campaign(), far=0.2).closed_loop(folder).run_control(0)
    return folder


@pytest.fixture
def prepared(controls: Path, tmp_path: Path) -> Path:
    """A folder for a search that has its runs without an attack already."""
    shutil.copytree(controls, tmp_path / CONTROLS, copy_function=os.link)
    return tmp_path


@pytest.fixture
def search(normal_card: Path, prepared: Path) -> Callable[..., Result]:
    """The command on one template."""

    def run(budget: int, *more: str) -> Result:
        words = [
            "search", "range_drift", "--reference", str(normal_card), "--budget", str(budget),
            "--far", "0.2", "--blocks", "1", "--goals", "1", "--workers", "1",
            "--out", str(prepared), *more,
        ]  # fmt: skip
        return CliRunner().invoke(oracle_sim, words)

    return run


def test_a_search_can_be_resumed(search: Callable[..., Result], tmp_path: Path) -> None:
    documents = []
    for budget in (1, 2):
        result = search(budget, "--no-screen", "--range", "rate=-0.02:0.02")
        assert result.exit_code == 0, result.output
        documents.append(json.loads((tmp_path / "findings.json").read_text()))
    assert "rate" in documents[1]["impacts"]
    found = [document["findings"] for document in documents]
    assert [len(each) for each in found] == [1, 2]
    assert found[1][:1] == found[0]
    rates = [each["proposal"]["values"]["rate"] for each in found[1]]
    assert len(set(rates)) == 2
    assert all(-0.02 <= rate <= 0.02 for rate in rates)
    assert (tmp_path / "front.png").read_bytes().startswith(b"\x89PNG")


def test_trials_detected_in_an_altered_recording_are_not_run(
    search: Callable[..., Result], tmp_path: Path
) -> None:
    result = search(1, "--range", "rate=0.5:0.9")
    assert result.exit_code == 0, result.output
    (finding,) = json.loads((tmp_path / "findings.json").read_text())["findings"]
    assert finding["screened_out"]
    assert finding["effects"] == {}


def test_an_attack_on_an_arm_is_compared_with_the_arm(tmp_path: Path) -> None:
    words = [
        "search", "arm_pose_offset", "--oracle", "implicit", "--budget", "1", "--blocks", "1",
        "--goals", "1", "--workers", "1", "--no-screen", "--range", "offset=0.3:0.5",
        "--out", str(tmp_path),
    ]  # fmt: skip
    result = CliRunner().invoke(oracle_sim, words)
    assert result.exit_code == 0, result.output
    (finding,) = json.loads((tmp_path / "findings.json").read_text())["findings"]
    assert finding["effects"]["goals_reached"] == -1.0
    assert [each.name for each in (tmp_path / CONTROLS / "runs").iterdir()] == ["arm_normal"]


REQUIREMENTS = """requirements:
  - name: few_turns
    formula: always (turn <= {})
    scale: 0.1
"""


@pytest.mark.parametrize(("most", "passed"), [(9.0, True), (-9.0, False)])
def test_requirements_are_an_oracle_and_robustness_is_its_score(
    prepared: Path, tmp_path: Path, most: float, passed: bool
) -> None:
    (tmp_path / "mine.yaml").write_text(REQUIREMENTS.format(most), "utf-8")
    words = [
        "search", "range_drift", "--oracle", str(tmp_path / "mine.yaml"), "--budget", "1",
        "--feedback", "belief", "--no-screen", "--blocks", "1", "--goals", "1", "--workers", "1",
        "--out", str(tmp_path),
    ]  # fmt: skip
    result = CliRunner().invoke(oracle_sim, words)
    assert result.exit_code == 0, result.output
    (finding,) = json.loads((tmp_path / "findings.json").read_text())["findings"]
    assert finding["passed"] == passed == (finding["score"] < 0.0)
    assert finding["feedback"] is not None


@pytest.mark.parametrize(
    ("oracle", "far", "reason"),
    [
        ("invariant", "0.2", "there is no oracle 'invariant'; give a card"),
        ("implicit", "0.05", "1 normal recordings in .* are left to decide"),
        ("invariants", "0.2", "need at least 3 normal runs"),
    ],
)
def test_an_unusable_oracle_ends_the_search_with_a_reason(
    recorded_run: RecordedRuns, prepared: Path, oracle: str, far: str, reason: str
) -> None:
    words = [
        "search", "range_drift", "--oracle", oracle, "--budget", "1", "--blocks", "1",
        "--normal", str(recorded_run(CONTROL, 1, OF_SEARCH).path), "--far", far,
        "--goals", "1", "--workers", "1", "--out", str(prepared),
    ]  # fmt: skip
    result = CliRunner().invoke(oracle_sim, words)
    assert result.exit_code != 0
    assert re.search(reason, result.output), result.output


def test_a_search_without_a_template_chooses_topics_and_operators(
    normal_card: Path, tmp_path: Path
) -> None:
    words = [
        "search", "--topic", "/odom", "--operator", "delay", "--operator", "drift",
        "--reference", str(normal_card), "--budget", "2", "--far", "0.2", "--blocks", "1",
        "--goals", "1",
        "--workers", "1", "--wiring", "absent", "--sampler", "guided", "--out", str(tmp_path),
    ]  # fmt: skip
    result = CliRunner().invoke(oracle_sim, words)
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "findings.json").read_text())["findings"]
    assert {each["proposal"]["values"]["operator"] for each in found} <= {"delay", "drift"}
    assert {each["proposal"]["document"]["main"]["output"] for each in found} == {"/odom"}


def miss(attack: Attack) -> Finding:
    """A run of an attack with an effect that the oracle missed."""
    return Finding(
        Proposal(7, 0, attack.document, attack.values), screened_out=False, effect=2.0,
        effects={"driven_m": 1.5}, score=1.0, p_value=0.4, passed=True, families=(), moved=(),
    )  # fmt: skip


def test_a_miss_is_a_mode_with_the_found_values_as_defaults(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    space = scenario_attacks(find_mode("range_drift"))
    study = optuna.create_study()
    study.enqueue_trial({"rate": 0.0125})
    finding = miss(space.suggest(study.ask()))
    (path,) = save(tmp_path, [finding], [finding], 0.05, tmp_path / "corpus", 7)
    (program,) = compile_file(path)
    assert program.scenario.id == "range_drift_miss007"
    assert place_of(path) == (7, 0)
    assert program.parameters["rate"].default == 0.0125
    assert misses([dataclasses.replace(finding, passed=False)]) == []
    monkeypatch.setenv("ORACLE_SCENARIOS", str(path.parent))
    mode = modes()["range_drift_miss007"]
    recipe = recipe_for(mode, 3, Campaign())
    assert recipe.parameters == {"rate": 0.0125}
    assert "unaltered" not in modes()  # its runs have a node, as normal ones have


def test_a_found_attack_is_a_row_of_the_evaluation(
    recorded_run: RecordedRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = {"/cmd_vel": "geometry_msgs/msg/Twist"}
    space = composed_attacks(["/cmd_vel"], ["scale"], there, allow_actuation=True)
    study = optuna.create_study()
    field = {"field of geometry_msgs/msg/Twist": "linear.x"}
    change = {"scale change": 0.4, "scale change < 0": True}
    study.enqueue_trial({**field, **change, "onset_s": 1.0, "lasts_s": 20.0})
    finding = miss(space.suggest(study.ask()))
    (path,) = save(tmp_path, [finding], [finding], 0.05, tmp_path / "corpus", 7)
    monkeypatch.setenv("ORACLE_SCENARIOS", str(path.parent))
    assert "composed_miss007" not in modes()  # it moves the robot
    monkeypatch.setenv("ORACLE_ALLOW_ACTUATION", "1")
    runs = [
        recorded_run(modes()[name], run)
        for name in ("unaltered", "composed_miss007")
        for run in range(2)
    ]
    tables = []
    for directory in runs:
        with open_run(directory.path) as run:
            tables.append(extract(run, build_manager()))
    manifests = [run.manifest() for run in runs]
    assert all(each.changes for each in manifests[2:])
    found = evaluate(
        feature_dataset(each.run for each in tables),
        window_dataset(each.windows for each in tables),
        truth_table(manifests),
    )
    assert "normal / composed_miss007" in set(found.table["scope"])


def test_a_normal_run_in_place_is_a_run_without_a_node(recorded_run: RecordedRuns) -> None:
    unaltered = recorded_run(find_mode("unaltered"), 0)
    absent = Campaign(goals_per_run=1, options=Options(wiring="absent"))
    without = recorded_run("lidar_passthrough_odom", 0, absent)
    ours, theirs = unaltered.manifest(), without.manifest()
    recorded = {name: of for name, of in ours.topics.items() if name != GROUND_TRUTH_TOPIC}
    assert recorded == theirs.topics  # which features see
    assert ours.goal_results == theirs.goal_results
