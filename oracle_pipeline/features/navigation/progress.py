"""Nav2 on the way to its goals: recoveries, plans, detours, standing still.

From the behaviour tree's log, the plans and odometry. Duration and outcome of the goals are in
``goals``, whose reading of the log and of the action's status this module uses.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.geometry.scans import Floats, Ints, Points
from oracle_pipeline.features.motion import odometry
from oracle_pipeline.features.navigation import goals
from oracle_pipeline.features.navigation.goals import GOAL_TOPICS, PLANS, Goal, time_under_way
from oracle_pipeline.features.statistics.reduction import mean, quantile, within
from oracle_pipeline.robots.roles import BEHAVIOR_TREE, ODOMETRY

_RECOVERY_FEATURES = (
    fp.Feature("recoveries", "1/min", 0.5, "recovery behaviours (spin, back up, wait, drive) per "
        "minute", "navigation", behaviour=True),
    fp.Feature(
        "costmap_clearings", "1/min", 0.5, "costmap clearings by the behaviour tree per minute",
        "navigation", behaviour=True,
    ),
)  # fmt: skip
PLAN_FEATURES = (
    fp.Feature("replans", "1/min", 1.0, "plans to active goals per minute with one", "navigation",
        behaviour=True),
    fp.Feature("plan_lengthening", "m", 0.05,
        "increase in length from one plan to the next to the same goal, 95th percentile",
        "navigation", behaviour=True),
    fp.Feature("progress", "m/s", 0.01, "decrease in plan length to a goal per second, median",
        "navigation", behaviour=True),
)  # fmt: skip
_DRIVE_FEATURES = (
    fp.Feature("path_efficiency", "1", 0.01,
        "length of the first plans over the distance driven, for goals that ended", "navigation",
        per_window=False, behaviour=True),
    fp.Feature("stalled", "1", 0.01,
        "share of the time with an active goal in which the robot is less than 0.1 m from where "
        "it was 5 s earlier", "navigation", behaviour=True),
    fp.Feature("longest_stall", "s", 1.0, "longest continuous stall, as in stalled", "navigation",
        per_window=False, behaviour=True, extensive=True),
    fp.Feature(
        "driven_without_goal", "m", 0.02, "distance driven without an active goal", "navigation",
        behaviour=True, extensive=True,
    ),
)  # fmt: skip

_RECOVERIES = ("Spin", "BackUp", "Wait", "DriveOnHeading")  # in Nav2's behaviour trees
_CLEARING = "Clear"  # prefix of the names of nodes that clear a costmap

_STALLED_S, _STALLED_M = 5.0, 0.1
_LEAST_S = 5.0  # of time under way that plans are counted in: a window
_STEP_S = 0.2  # between the times at which stalling is determined


@dataclass(frozen=True, slots=True)
class _Plans:
    """Plans made while a goal was active."""

    goals: list[Goal]
    made: fp.Series  # lengths [m]
    lengthening: fp.Series  # of a plan against the one before to the same goal [m]
    progress: fp.Series  # [m/s]


@dataclass(frozen=True, slots=True)
class _Drive:
    """Statistics of the robot's way to its goals."""

    efficiency: float | fp.Missing
    stalled: fp.Series  # 1 or 0, at each step with an active goal
    without_goal: fp.Series  # way since the last message [m], at times without an active goal


def _keep_begun(message: Any) -> tuple[int, int]:
    """Return the numbers of recoveries and clearings that a ``BehaviorTreeLog`` begins."""
    begun = [
        change.node_name
        for change in message.event_log
        if change.previous_status == "IDLE" and change.current_status != "IDLE"
    ]
    return (
        sum(name in _RECOVERIES for name in begun),
        sum(name.startswith(_CLEARING) for name in begun),
    )


def _compute_recoveries(window: fp.Window) -> fp.Values | fp.Missing:
    """Count over the window; a silent tree counts as none."""
    if not window.history["log"]:
        return fp.Missing("no behaviour tree log is recorded")
    begun = sum(series.values.sum(axis=0) for series in window.topics["log"].values())
    recoveries, clearings = np.broadcast_to(begun, 2) * 60.0 / (window.end_s - window.start_s)
    return {"recoveries": float(recoveries), "costmap_clearings": float(clearings)}


def _prepare_plans(window: fp.Window) -> _Plans | fp.Missing:
    """Assign the plans to their goals."""
    accepted = _accepted(window)
    if isinstance(accepted, fp.Missing):
        return accepted
    ((times_s, lengths_m),) = window.topics["plan"].values()
    goal = goal_at(accepted, times_s)
    same = (goal[1:] == goal[:-1]) & (goal[1:] >= 0) & (np.diff(times_s) > 0.0)
    after_s, change_m = times_s[1:][same], np.diff(lengths_m)[same]
    return _Plans(
        accepted,
        fp.Series(times_s[goal >= 0], lengths_m[goal >= 0]),
        fp.Series(after_s, np.maximum(0.0, change_m)),
        fp.Series(after_s, -change_m / np.diff(times_s)[same]),
    )


def _compute_plans(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    plans: _Plans = window.prepared
    count = len(plans.made.times_s[within(plans.made.times_s, window)])
    under_way_s = max(time_under_way(plans.goals, window), _LEAST_S)
    single = fp.Missing("no goal had two plans in this window")
    lengthening = quantile(plans.lengthening, window, 0.95)
    progress = quantile(plans.progress, window, 0.5)
    return {
        "replans": 60.0 * count / under_way_s,
        "plan_lengthening": single if math.isnan(lengthening) else lengthening,
        "progress": single if math.isnan(progress) else progress,
    }


def _prepare_drive(window: fp.Window) -> _Drive | fp.Missing:
    """Compute the efficiency and stalls of the whole recording."""
    accepted = _accepted(window)
    if isinstance(accepted, fp.Missing):
        return accepted
    (driven,) = window.topics["odometry"].values()
    return _Drive(
        _efficiency(accepted, fp.sole_series(window.topics["plan"]), driven),
        stalls(accepted, driven),
        _driven_without_goal(accepted, driven),
    )


def _compute_drive(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    drive: _Drive = window.prepared
    idle = fp.Missing(f"no goal was active for {_STALLED_S:g} s")
    stalled = mean(drive.stalled, window)
    inside = drive.stalled.values[within(drive.stalled.times_s, window)]
    return {
        "path_efficiency": drive.efficiency,
        "stalled": idle if math.isnan(stalled) else stalled,
        "longest_stall": longest(inside == 1.0) * _STEP_S if inside.size else idle,
        "driven_without_goal": float(
            drive.without_goal.values[within(drive.without_goal.times_s, window)].sum()
        ),
    }


def goal_at(accepted: Sequence[Goal], times_s: Floats) -> Ints:
    """Return the index of the active goal at each time, -1 without one."""
    starts = np.array([goal.accepted_s for goal in accepted])
    ends = np.array([math.inf if goal.ended_s is None else goal.ended_s for goal in accepted])
    number = np.searchsorted(starts, times_s, side="right") - 1
    return np.where((number >= 0) & (times_s <= ends[number]), number, -1)


def stalls(accepted: Sequence[Goal], driven: fp.Series) -> fp.Series:
    """Return, step by step, whether the robot made no progress towards its goal.

    Values are 1 or 0, at steps where the same goal has been active for `_STALLED_S`.
    """
    steps_s = np.arange(driven.times_s[0] + _STALLED_S, driven.times_s[-1], _STEP_S)
    goal = goal_at(accepted, steps_s)
    under_way = (goal >= 0) & (goal == goal_at(accepted, steps_s - _STALLED_S))
    steps_s = steps_s[under_way]
    now, before = _places(driven, steps_s), _places(driven, steps_s - _STALLED_S)
    return fp.Series(steps_s, (np.abs(now - before) < _STALLED_M).astype(np.float64))


def longest(flags: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of true flags."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return int(np.max(ends[1::2] - ends[::2], initial=0))


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of navigation."""
    begun = {"log": fp.Request(_keep_begun, role=BEHAVIOR_TREE, optional=True)}
    driven = {
        "plan": replace(PLANS, optional=True),
        "odometry": fp.Request(odometry.keep, role=ODOMETRY, many=True),
    }
    return [
        fp.FeaturePlugin(
            "recoveries", "navigation", _RECOVERY_FEATURES, _compute_recoveries, begun
        ),
        fp.FeaturePlugin(
            "plans", "navigation", PLAN_FEATURES, _compute_plans, GOAL_TOPICS | {"plan": PLANS},
            prepare=_prepare_plans,
        ),
        fp.FeaturePlugin(
            "drive", "navigation", _DRIVE_FEATURES, _compute_drive, GOAL_TOPICS | driven,
            prepare=_prepare_drive,
        ),
    ]  # fmt: skip


def _accepted(window: fp.Window) -> list[Goal] | fp.Missing:
    """Return the accepted goals of a recording; missing without one."""
    return goals.goals_so_far(window) or fp.Missing("no goal was accepted")


def _efficiency(
    accepted: Sequence[Goal], plans: fp.Series | None, driven: fp.Series
) -> float | fp.Missing:
    if plans is None:
        return fp.Missing("no plan is recorded")
    planned_m = driven_m = 0.0
    places = driven.values[:, 0] + 1j * driven.values[:, 1]
    for goal in accepted:
        if goal.ended_s is None:
            continue
        first, after = np.searchsorted(plans.times_s, (goal.accepted_s, goal.ended_s))
        start, end = np.searchsorted(driven.times_s, (goal.accepted_s, goal.ended_s))
        if first < after:
            planned_m += float(plans.values[first])
            driven_m += float(np.abs(np.diff(places[start:end])).sum())
    return planned_m / driven_m if driven_m > 0.0 else fp.Missing("no goal with a plan ended")


def _driven_without_goal(accepted: Sequence[Goal], driven: fp.Series) -> fp.Series:
    steps_m = np.hypot(*np.diff(driven.values[:, :2], axis=0).T)
    times_s = driven.times_s[1:]
    idle = goal_at(accepted, times_s) < 0
    return fp.Series(times_s[idle], steps_m[idle])


def _places(driven: fp.Series, times_s: Floats) -> Points:
    x, y = (np.interp(times_s, driven.times_s, column) for column in driven.values.T[:2])
    places: Points = x + 1j * y
    return places
