"""What an attack did to the robot's task: an attacked run against its block's control."""

import contextlib
from typing import Any

from oracle_pipeline.bags.errors import ManifestError, RunDirectoryError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bags.run_directory import RunDirectory

CONTROL = "lidar_passthrough_odom"  # of attacks that have no pair of their own
LONGER = 1.15  # a way this much longer than the control's is an effect


def judge_pair(directory: RunDirectory) -> None:
    """Note ``task_effect`` in attacked runs that this run is the control of, or in itself.

    Whichever of the two is finished last does it; runs of different campaigns, conditions, wirings
    or noise are not compared. So where each run has noise of its own, the control is the shadow.
    """
    for path in sorted(directory.root.glob(f"runs/*/{directory.run_id}")):
        # A folder that is no mode's, or a manifest that cannot be read, is not this run's trouble.
        with contextlib.suppress(RunDirectoryError, ManifestError):
            other = RunDirectory(directory.root, path.parent.name, directory.run)
            for attack, control in ((directory, other), (other, directory)):
                if control.mode in _controls_of(attack.mode):
                    _judge(attack, control)


def _controls_of(mode: str) -> tuple[str, str]:
    """Return the modes whose runs show how an attacked one would have gone."""
    paired = next((control for control, attack in PAIRS if attack == mode), CONTROL)
    return paired, f"{mode}_shadow"


def _judge(attack: RunDirectory, control: RunDirectory) -> None:
    if not (attack.is_complete() and control.is_complete()):
        return
    attacked, right = attack.manifest(), control.manifest()
    if attacked.label != "malicious" or _setting(attacked) != _setting(right):
        return
    effect = task_effect(attacked, right)
    if effect != attacked.task_effect:
        attack.amend(task_effect=effect)


def _setting(run: Manifest) -> dict[str, Any]:
    """Return what a run was made from, but for what its mode's node does and how it was stored."""
    aside = ("mode", "scenario", "parameters", "storage")
    return {key: value for key, value in run.recipe.items() if key not in aside}


def task_effect(attacked: Manifest, control: Manifest) -> bool:
    """Tell whether a run of the same block went another way than its control.

    It did if a goal came out differently, or the way to one was more than 1.15 times as long, or
    took a recovery more.
    """
    if len(attacked.goal_results) != len(control.goal_results):
        return True
    return any(
        ours.outcome != theirs.outcome
        or ours.driven_m > LONGER * theirs.driven_m
        or ours.recoveries > theirs.recoveries
        for ours, theirs in zip(attacked.goal_results, control.goal_results, strict=True)
    )
