"""The effect of an attack on the robot's task: an attacked run compared with its control.

Whether an effect is more than chance is decided by the evaluation, over many runs.
"""

import contextlib
from typing import Any

from oracle_pipeline.bags.behaviour import behaviour
from oracle_pipeline.bags.errors import ManifestError, RunDirectoryError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.fuzzing.scenario import Scenario
from sim.testbeds import TESTBEDS, which_testbed

CONTROL = "lidar_passthrough_odom"  # of a TurtleBot3's attacks that have no pair of their own


def control_of(scenario: Scenario) -> str:
    """Return the mode that attacks of a scenario's testbed are compared with."""
    experiments = TESTBEDS[which_testbed(scenario)].experiments
    return CONTROL if CONTROL in experiments else experiments[0]


def judge_pair(directory: RunDirectory) -> None:
    """Store ``task_effect`` in this attacked run, or in those that this run is the control of.

    The later of the two runs does it. Runs of different campaigns, conditions, wirings or noise are
    not compared. So if noise is drawn per run, the control is the shadow.
    """
    for path in sorted(directory.root.glob(f"runs/*/{directory.run_id}")):
        if path == directory.path:
            continue
        # A folder that is no mode's, or a manifest that cannot be read, does not concern this run.
        with contextlib.suppress(RunDirectoryError, ManifestError):
            other = RunDirectory(directory.root, path.parent.name, directory.run)
            for attack, control in ((directory, other), (other, directory)):
                if control.mode in _controls_of(attack.mode):
                    _judge(attack, control)


def _controls_of(mode: str) -> tuple[str, str]:
    """Return the control modes of an attacked mode."""
    paired = next((control for control, attack in PAIRS if attack == mode), CONTROL)
    return paired, f"{mode}_shadow"


def _judge(attack: RunDirectory, control: RunDirectory) -> None:
    if not (attack.is_complete() and control.is_complete()):
        return
    attacked = attack.manifest()
    if attacked.label != "malicious":
        return
    right = control.manifest()
    if _setting(attacked) != _setting(right):
        return
    effect = task_effect(attacked, right)
    if effect != attacked.task_effect:
        attack.amend(task_effect=effect)


def _setting(run: Manifest) -> dict[str, Any]:
    """Return the recipe of a run without its mode's scenario and storage."""
    aside = ("mode", "scenario", "parameters", "storage")
    return {key: value for key, value in run.recipe.items() if key not in aside}


def task_effect(attacked: Manifest, control: Manifest) -> dict[str, float] | None:
    """Return how much more an attacked run has of each quantity of behaviour than its control.

    None if the behaviour was not measured in both.
    """
    ours, theirs = behaviour(attacked), behaviour(control)
    return {name: ours[name] - theirs[name] for name in ours if name in theirs} or None
