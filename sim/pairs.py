"""What an attack did to the robot's task: an attacked run against its block's control."""

import dataclasses

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.modes import PAIRS

LONGER = 1.15  # a way this much longer than the control's is an effect


def judge_pair(directory: RunDirectory) -> None:
    """Note ``task_effect`` in the attacked run of a pair, once its control is there as well.

    Whichever of the two is finished last does it; runs of different campaigns are not compared.
    """
    for control, attack in PAIRS:
        if directory.mode not in (control, attack):
            continue
        pair = [RunDirectory(directory.root, mode, directory.run) for mode in (control, attack)]
        if not all(run.is_complete() for run in pair):
            continue
        right, attacked = (run.manifest() for run in pair)
        storage = {"storage": right.recipe["storage"]}  # what a bag is kept in has no effect
        if {**attacked.recipe, "mode": control, **storage} == right.recipe:
            effect = task_effect(attacked, right)
            if effect != attacked.task_effect:
                pair[1].amend(dataclasses.replace(attacked, task_effect=effect))


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
