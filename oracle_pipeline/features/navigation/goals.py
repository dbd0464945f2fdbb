"""Duration and outcome of navigation, from Nav2's messages.

The thesis takes the length of the bag, in nanoseconds. Here it is the time with a goal under way,
from the action's status if it was recorded (``-a`` leaves that hidden topic out), else from the
behaviour tree's log. Times are those of the recording.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.engine.plugin import (
    Feature,
    FeaturePlugin,
    Missing,
    Request,
    Series,
    Values,
    Window,
    hookimpl,
    sole_series,
)
from oracle_pipeline.robots.roles import BEHAVIOR_TREE, GOAL_STATUS, PLAN

FEATURES = (
    Feature(
        "duration", "s", 0.1, "time with an active goal", "navigation", behaviour=True,
        extensive=True,
    ),
    Feature(
        "goals_reached", "1", 0.01, "share of the accepted goals that were reached", "navigation",
        per_window=False, behaviour=True,
    ),
    Feature(
        "time_per_planned_metre", "s/m", 0.1,
        "duration of the goals that ended over the total length of their first plans", "navigation",
        per_window=False, behaviour=True,
    ),
)  # fmt: skip

# States of action_msgs/msg/GoalStatus.
_ACTIVE = (1, 2, 3)  # accepted, executing, canceling
_SUCCEEDED = 4
_ROOT = "NavigateRecovery"  # root node of Nav2's behaviour trees
_REPORTS = ("SUCCESS", "FAILURE")


@dataclass(frozen=True, slots=True)
class Goal:
    """One goal, in seconds of the recording; without an end while it is active."""

    accepted_s: float
    ended_s: float | None = None
    reached: bool = False


def compute(window: Window) -> Values | Missing:
    """Compute from all messages up to the end of the window."""
    goals = goals_so_far(window)
    if isinstance(goals, Missing):
        return goals
    none = Missing("no goal was accepted")
    return {
        "duration": _time_under_way(goals, window),
        "goals_reached": sum(g.reached for g in goals) / len(goals) if goals else none,
        "time_per_planned_metre": _time_per_planned_metre(goals, window),
    }


def goals_so_far(window: Window) -> list[Goal] | Missing:
    """Return the goals so far, from the action's status or else from the behavior tree's log."""
    status = sole_series(window.history["status"])
    if status is not None and len(status.times_s):
        return _goals_of_status(status)
    log = sole_series(window.history["log"])
    if log is None:
        return Missing("neither a goal status nor a behaviour tree log is recorded")
    return goals_of_log(log)


def _goals_of_status(series: Series) -> list[Goal]:
    """Return the goals in messages of ``action_msgs/msg/GoalStatusArray``.

    A goal that had ended by its first message belongs to the time before the recording.
    """
    goals: dict[bytes, Goal] = {}
    for time_s, states in zip(series.times_s, series.values, strict=True):
        for goal_id, status in states:
            goal = goals.get(goal_id)
            if goal is None and status in _ACTIVE:
                goals[goal_id] = Goal(time_s)
            elif goal is not None and goal.ended_s is None and status not in _ACTIVE:
                goals[goal_id] = Goal(goal.accepted_s, time_s, status == _SUCCEEDED)
    return list(goals.values())


def goals_of_log(series: Series) -> list[Goal]:
    """Return the goals in messages of ``nav2_msgs/msg/BehaviorTreeLog``.

    A goal is active while the root of the tree runs. The root is halted before it reports, so a
    goal that ends has the changes ``RUNNING -> IDLE -> SUCCESS`` (or ``FAILURE``) in one message;
    a cancelled one has only the first change.
    """
    goals: list[Goal] = []
    for time_s, states in zip(series.times_s, series.values, strict=True):
        for state in states:
            under_way = bool(goals) and goals[-1].ended_s is None
            just_ended = bool(goals) and goals[-1].ended_s == time_s
            if (under_way and state != "RUNNING") or (just_ended and state in _REPORTS):
                goals[-1] = Goal(goals[-1].accepted_s, time_s, state == "SUCCESS")
            elif not under_way and state == "RUNNING":
                goals.append(Goal(time_s))
            elif state in _REPORTS:  # began and ended in the same tick
                goals.append(Goal(time_s, time_s, state == "SUCCESS"))
    return goals


def _keep_status(message: Any) -> list[tuple[bytes, int]]:
    """Return identifier and state of each goal."""
    return [(s.goal_info.goal_id.uuid.tobytes(), s.status) for s in message.status_list]


def _keep_log(message: Any) -> list[str] | None:
    """Return the states that the root of the tree changed to; None if it did not change."""
    return [c.current_status for c in message.event_log if c.node_name == _ROOT] or None


def _keep_plans(messages: Any) -> NDArray[np.float64]:
    """Return the lengths of paths [m]."""
    position = messages.poses.pose.position
    begins = np.searchsorted(messages.poses.owners, np.arange(len(messages) + 1)).tolist()
    steps = np.hypot(np.diff(position.x), np.diff(position.y))
    return np.array([
        steps[first : max(first, after - 1)].sum() for first, after in pairwise(begins)
    ])  # fmt: skip


#: Topics with the states of goals; a robot may lack either.
GOAL_TOPICS = {
    "status": Request(_keep_status, role=GOAL_STATUS, dtype=object, optional=True, carried=True),
    "log": Request(_keep_log, role=BEHAVIOR_TREE, dtype=object, optional=True, carried=True),
}
PLANS = Request(_keep_plans, role=PLAN, many=True, carried=True)


@hookimpl
def register_features() -> list[FeaturePlugin]:
    """Offer the features of navigation."""
    topics = GOAL_TOPICS | {"plan": replace(PLANS, optional=True)}
    return [FeaturePlugin("goals", "contextual", FEATURES, compute, topics)]


def _time_under_way(goals: list[Goal], window: Window) -> float:
    def overlap_s(goal: Goal) -> float:
        ended_s = window.end_s if goal.ended_s is None else min(goal.ended_s, window.end_s)
        return max(0.0, ended_s - max(goal.accepted_s, window.start_s))

    return float(sum(map(overlap_s, goals)))


def _time_per_planned_metre(goals: list[Goal], window: Window) -> float | Missing:
    plans = sole_series(window.history["plan"])
    if plans is None:
        return Missing("no plan is recorded")
    time_s = planned_m = 0.0
    for goal in goals:
        if goal.ended_s is None:
            continue
        first, after = np.searchsorted(plans.times_s, (goal.accepted_s, goal.ended_s))
        if first < after:
            time_s += goal.ended_s - goal.accepted_s
            planned_m += float(plans.values[first])
    return time_s / planned_m if planned_m > 0.0 else Missing("no goal that ended had a plan")
