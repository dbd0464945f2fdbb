"""The effect of an attack on the robot's task: an attacked run compared with its control.

Only the evaluation can tell from many runs whether an effect is more than chance.
"""

import contextlib
from typing import Any

from oracle_pipeline.bags.behaviour import behaviour
from oracle_pipeline.bags.errors import ManifestError, RunDirectoryError
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bags.run_directory import RunDirectory

CONTROL = "lidar_passthrough_odom"  # of attacks that have no pair of their own


def judge_pair(directory: RunDirectory) -> None:
    """Note ``task_effect`` in attacked runs that this run is the control of, or in itself.

    Whichever of the two is finished last does it; runs of different campaigns, conditions, wirings
    or noise are not compared. So where each run has noise of its own, the control is the shadow.
    """
    for path in sorted(directory.root.glob(f"runs/*/{directory.run_id}")):
        if path == directory.path:
            continue
        # A folder that is no mode's, or a manifest that cannot be read, is not this run's trouble.
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
    """Return what a run was made from, but for what its mode's node does and how it was stored."""
    aside = ("mode", "scenario", "parameters", "storage")
    return {key: value for key, value in run.recipe.items() if key not in aside}


def task_effect(attacked: Manifest, control: Manifest) -> dict[str, float] | None:
    """Return how much more an attacked run has of each quantity of behaviour than its control.

    None if what the robot did was not measured in both.
    """
    ours, theirs = behaviour(attacked), behaviour(control)
    return {name: ours[name] - theirs[name] for name in ours if name in theirs} or None
