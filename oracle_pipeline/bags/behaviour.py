"""Quantities that describe the behaviour of a robot in one run, from its manifest's ground truth.

The simulator uses them to compare an attacked run with its control, the evaluation to compare any
run with the others of its block.
"""

from collections.abc import Mapping

from oracle_pipeline.bags.manifest import Manifest

UNITS: Mapping[str, str] = {
    "driven_m": "m", "under_way_s": "s", "clearance_m": "m",
    "goals_reached": "1", "recoveries": "1", "commands_altered": "1",
}  # fmt: skip
"""The quantities, and their units."""


def behaviour(run: Manifest) -> dict[str, float]:
    """Return the quantities of a run; empty for a system without goals.

    They are the way and the time with an active goal, over all goals; and the goals reached. Of
    robots that drive, they are also the smallest distance of the base from any surface; the
    recoveries that Nav2 tried; and the share of non-zero velocity commands that the collision
    monitor slowed down or stopped.
    """
    goals, drive = run.goal_results, run.drive
    if drive is None and not goals:
        return {}
    ends = [run.recording_s if goal.ended_s is None else goal.ended_s for goal in goals]
    quantities = {
        "driven_m": sum(goal.driven_m for goal in goals),
        "under_way_s": sum(e - goal.accepted_s for e, goal in zip(ends, goals, strict=True)),
        "goals_reached": float(sum(goal.outcome == "succeeded" for goal in goals)),
    }
    if drive is not None:
        quantities["recoveries"] = float(sum(goal.recoveries for goal in goals))
        quantities["commands_altered"] = drive.commands_altered / max(1, drive.commands)
        if drive.clearance_m is not None:
            quantities["clearance_m"] = drive.clearance_m
    return quantities
