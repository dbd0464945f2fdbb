"""Attacked runs against their controls, on given manifests."""

import dataclasses

import pytest

from oracle_pipeline.bags.behaviour import UNITS
from oracle_pipeline.bags.manifest import Drive, GoalResult, Manifest, Measured, Pose, Software
from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.modes import modes
from sim.pairs import control_of, judge_pair, task_effect
from sim.testbeds import which_testbed


@pytest.mark.parametrize("mode", [mode for mode in modes().values() if mode.label == "malicious"])
def test_attacks_are_compared_with_normal_runs_of_their_testbed(mode):
    control = modes()[control_of(mode.scenario)]
    assert control.label == "normal"
    assert which_testbed(control.scenario) == which_testbed(mode.scenario)


SUCCEEDED = GoalResult(2.0, 20.0, "succeeded", 4.0, 0)
LABELS = {control: "normal" for control, _ in PAIRS} | {"random_noise_shadow": "control"}
RECIPE = {"mode": "lidar_passthrough", "seed": 1, "storage": "mcap"}


def manifest(mode="lidar_passthrough", *goals, **recipe):
    return Manifest(
        mode=mode, label=LABELS.get(mode, "malicious"), run=0, block=0,
        session=0, world="hexagon-0", seed=1,
        start=Pose(0.0, 0.0, 0.0),
        goals=(), goal_results=goals or (SUCCEEDED,), outcome="succeeded", onset_s=None, attack={},
        scenario=mode, scenario_hash="h", task_effect=None,
        drive=Drive(0.5, 100, 0), recording_s=30.0, contacts=(),
        topics={}, content_hash="0" * 64, recipe={**RECIPE, "mode": mode, **recipe},
        software=Software("c", "d", "x"), measured=Measured(1.0, {}),
    )  # fmt: skip


def place(root, run):
    directory = RunDirectory(root, run.mode, run.run)
    directory.path.mkdir(parents=True)
    run.save(directory.manifest_path)
    return directory


def test_an_effect_is_the_increase_of_each_quantity():
    late = GoalResult(25.0, None, "timeout", 6.5, 2)  # the recording ended at 30 s
    attacked = manifest("random_noise", SUCCEEDED, late)
    control = manifest("lidar_passthrough", SUCCEEDED, SUCCEEDED)
    attacked = dataclasses.replace(attacked, drive=Drive(0.25, 200, 50))
    assert task_effect(attacked, control) == {
        "driven_m": 2.5, "under_way_s": -13.0, "goals_reached": -1.0, "recoveries": 2.0,
        "commands_altered": 0.25, "clearance_m": -0.25,
    }  # fmt: skip
    assert task_effect(control, control) == dict.fromkeys(UNITS, 0.0)


def test_quantities_that_were_not_measured_are_not_compared():
    control = manifest("lidar_passthrough")
    still = dataclasses.replace(manifest("random_noise"), drive=None)
    assert task_effect(still, control).keys() == {"driven_m", "under_way_s", "goals_reached"}
    assert task_effect(dataclasses.replace(still, goal_results=()), control) is None
    nowhere = dataclasses.replace(manifest("random_noise"), drive=Drive(None, 0, 0))
    assert "clearance_m" not in task_effect(nowhere, control)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("pair", PAIRS)
def test_the_effect_is_stored_when_the_second_run_of_a_pair_ends(tmp_path, pair, order):
    longer = dataclasses.replace(SUCCEEDED, driven_m=9.0)
    runs = [manifest(pair[0]), manifest(pair[1], longer)]
    for index in order:
        judge_pair(place(tmp_path, runs[index]))
    control, attack = (RunDirectory(tmp_path, mode, 0).manifest() for mode in pair)
    assert control.task_effect is None
    assert attack.task_effect["driven_m"] == 5.0
    assert [file.name for file in RunDirectory(tmp_path, pair[1], 0).path.iterdir()] == [
        "manifest.json"
    ]


def test_runs_of_different_campaigns_are_not_compared(tmp_path):
    place(tmp_path, manifest("lidar_passthrough", seed=2))
    directory = place(tmp_path, manifest("random_noise"))
    judge_pair(directory)
    assert directory.manifest().task_effect is None


def test_a_bag_kept_in_another_storage_is_compared(tmp_path):
    place(tmp_path, manifest("lidar_passthrough", storage="sqlite3"))
    directory = place(tmp_path, manifest("random_noise"))
    judge_pair(directory)
    assert directory.manifest().task_effect == dict.fromkeys(UNITS, 0.0)


def test_an_attack_without_a_pair_is_compared_with_the_passthrough_with_odometry(tmp_path):
    longer = dataclasses.replace(SUCCEEDED, driven_m=9.0)
    for mode in ("sensor_freeze", "random_noise_shadow"):
        place(tmp_path, manifest(mode, longer, scenario={"id": mode}, parameters={"level": 0.1}))
    judge_pair(place(tmp_path, manifest("lidar_passthrough_odom")))
    effects = [
        RunDirectory(tmp_path, mode, 0).manifest().task_effect
        for mode in ("sensor_freeze", "random_noise_shadow", "lidar_passthrough_odom")
    ]
    assert effects == [{**dict.fromkeys(UNITS, 0.0), "driven_m": 5.0}, None, None]


def test_runs_of_different_wirings_are_not_compared(tmp_path):
    place(tmp_path, manifest("lidar_passthrough_odom", options={"wiring": "additive"}))
    directory = place(tmp_path, manifest("fake_object", options={"wiring": "replace"}))
    judge_pair(directory)
    assert directory.manifest().task_effect is None


@pytest.mark.parametrize("trouble", ["Archive", "old_mode"])
def test_other_files_beside_a_run_do_not_affect_it(tmp_path, trouble):
    (tmp_path / "runs" / trouble / "run000").mkdir(parents=True)
    (tmp_path / "runs" / trouble / "run000" / "manifest.json").write_text("{}")
    place(tmp_path, manifest("lidar_passthrough_odom"))
    directory = place(tmp_path, manifest("fake_object"))
    judge_pair(directory)
    assert directory.manifest().task_effect == dict.fromkeys(UNITS, 0.0)
