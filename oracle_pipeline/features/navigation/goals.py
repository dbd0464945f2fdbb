"""Duration and outcome of navigation, from Nav2's messages.

The thesis takes the length of the bag, in nanoseconds. Here it is the time with a goal under way,
from the action's status if it was recorded (``-a`` leaves that hidden topic out), else from the
behaviour tree's log. Times are those of the recording.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.robots.roles import BEHAVIOR_TREE, GOAL_STATUS, PLAN

FEATURES = (
    fp.Feature("duration", "s", 0.5, "time with an active goal", "navigation", behaviour=True,
        extensive=True),
    fp.Feature(
        "goals_reached", "1", 0.01, "share of the goals that ended, or take longer than any that "
        "ended, that were reached", "navigation", per_window=False, behaviour=True,
    ),
    fp.Feature("time_per_planned_metre", "s/m", 0.1,
        "duration of the goals that ended over the total length of their first plans", "navigation",
        per_window=False, behaviour=True),
)  # fmt: skip

# States of action_msgs/msg/GoalStatus.
_ACTIVE = (1, 2, 3)  # accepted, executing, canceling
_SUCCEEDED = 4
_BETWEEN_S = 0.5  # after the end of a goal, in which messages of its tree may still come
_LATCHED_S = 1.0  # after which the first message of a recording is no latched one
_ROOT = "NavigateRecovery"  # root node of Nav2's behaviour trees
_REPORTS = ("SUCCESS", "FAILURE")


@dataclass(frozen=True, slots=True)
class Goal:
    """One goal, in seconds of the recording; without an end while it is active."""

    accepted_s: float
    ended_s: float | None = None
    reached: bool = False


class RootChange(NamedTuple):
    """A change of the state of the tree's root, by the robot's clock."""

    stamp_s: float
    former: str
    state: str


def compute(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute from all messages up to the end of the window."""
    goals = goals_so_far(window)
    if isinstance(goals, fp.Missing):
        return goals
    counted = _counted(goals, window.end_s)
    none = fp.Missing("no goal ended")
    return {
        "duration": time_under_way(goals, window),
        "goals_reached": sum(g.reached for g in counted) / len(counted) if counted else none,
        "time_per_planned_metre": _time_per_planned_metre(goals, window),
    }


def goals_so_far(window: fp.Window) -> list[Goal] | fp.Missing:
    """Return the goals so far, from the action's status or else from the behavior tree's log."""
    status = fp.sole_series(window.history["status"])
    if status is not None and len(status.times_s):
        return _goals_of_status(status)
    log = fp.sole_series(window.history["log"])
    if log is None:
        return fp.Missing("neither a goal status nor a behaviour tree log is recorded")
    ticks = fp.sole_series(window.history["ticks"])
    goals = goals_of_log(log, log.times_s if ticks is None else ticks.times_s)
    if not goals and ticks is not None and len(ticks.times_s):
        return fp.Missing("the tree ran before the recording began, or its root has another name")
    return goals


def _goals_of_status(series: fp.Series) -> list[Goal]:
    """Return the goals in messages of ``action_msgs/msg/GoalStatusArray``.

    A goal that is new and has ended began after the message before, which was lost. If there is
    none, it was under way when the recording began, or had ended before.
    """
    goals: dict[bytes, Goal] = {}
    before_s = None
    for time_s, states in zip(series.times_s, series.values, strict=True):
        for place, (goal_id, status) in enumerate(states):
            goal = goals.get(goal_id)
            if goal is None and status in _ACTIVE:
                goals[goal_id] = Goal(time_s)
            elif goal is not None and goal.ended_s is None and status not in _ACTIVE:
                goals[goal_id] = Goal(goal.accepted_s, time_s, status == _SUCCEEDED)
            elif goal is None:
                has_just_ended = place == len(states) - 1 and time_s > _LATCHED_S
                known_s = 0.0 if before_s is None and has_just_ended else before_s
                accepted_s = time_s if known_s is None else known_s
                goals[goal_id] = Goal(accepted_s, time_s, status == _SUCCEEDED)
        before_s = time_s
    return [goal for goal in goals.values() if goal.accepted_s != goal.ended_s]


def goals_of_log(series: fp.Series, ticks_s: NDArray[np.float64]) -> list[Goal]:
    """Return the goals in messages of ``nav2_msgs/msg/BehaviorTreeLog``.

    A goal is active while the root of the tree runs. The root is halted before it reports, so a
    goal that ends has the changes ``RUNNING -> IDLE -> SUCCESS`` (or ``FAILURE``) in one message;
    a cancelled one has only the first change. A change says what was before it, so a goal has a
    beginning and an end though their messages were lost, or came before the recording: they are at
    the nearest message of the tree.

    Parameters
    ----------
    series : Series
        Lists of `RootChange`, of the messages that have any.
    ticks_s : ndarray of shape (n,)
        Times of all messages; a tree that runs has some each second.
    """
    goals: list[Goal] = []
    changes = [
        (change, float(time_s))
        for time_s, of_message in zip(series.times_s, series.values, strict=True)
        for change in of_message
    ]
    for (_, former, state), time_s in sorted(changes, key=lambda each: each[0].stamp_s):
        if _is_under_way(goals) and former != "RUNNING":
            last_s = float(ticks_s[ticks_s < time_s].max(initial=goals[-1].accepted_s))
            goals[-1] = Goal(goals[-1].accepted_s, last_s, former == "SUCCESS")
        if not _is_under_way(goals) and "RUNNING" in (former, state):
            goals.append(Goal(time_s if state == "RUNNING" else _lost_s(goals, ticks_s)))
        if _is_under_way(goals) and state != "RUNNING":
            goals[-1] = Goal(goals[-1].accepted_s, time_s, state == "SUCCESS")
        elif state in _REPORTS and goals and goals[-1].ended_s == time_s:
            goals[-1] = replace(goals[-1], reached=state == "SUCCESS")
        elif state in _REPORTS:  # began and ended in the same tick
            goals.append(Goal(time_s, time_s, state == "SUCCESS"))
    ended_s = goals[-1].ended_s if goals else None
    if ended_s is not None and (ticks_s > ended_s + _BETWEEN_S).any():
        goals.append(Goal(_lost_s(goals, ticks_s)))
    return goals


def _lost_s(goals: list[Goal], ticks_s: NDArray[np.float64]) -> float:
    """Return when a goal began whose beginning is not recorded."""
    ended_s = goals[-1].ended_s if goals else None
    if ended_s is None:
        return 0.0
    return float(ticks_s[ticks_s > ended_s].min(initial=ticks_s.max()))


def _is_under_way(goals: list[Goal]) -> bool:
    return bool(goals) and goals[-1].ended_s is None


def _keep_status(message: Any) -> list[tuple[bytes, int]]:
    """Return identifier and state of each goal."""
    return [(s.goal_info.goal_id.uuid.tobytes(), s.status) for s in message.status_list]


def _keep_log(message: Any) -> list[RootChange] | None:
    """Return the changes of the root of the tree; None if there are none."""
    found = [
        RootChange(
            c.timestamp.sec + c.timestamp.nanosec * 1e-9, c.previous_status, c.current_status
        )
        for c in message.event_log
        if c.node_name == _ROOT
    ]
    return found or None


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
    "status": fp.Request(_keep_status, role=GOAL_STATUS, dtype=object, optional=True, carried=True),
    "log": fp.Request(_keep_log, role=BEHAVIOR_TREE, dtype=object, optional=True, carried=True),
    "ticks": fp.Request(lambda m: np.zeros(len(m)), role=BEHAVIOR_TREE, many=True, optional=True),
}
PLANS = fp.Request(_keep_plans, role=PLAN, many=True, carried=True)


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of navigation."""
    topics = GOAL_TOPICS | {"plan": replace(PLANS, optional=True)}
    return [fp.FeaturePlugin("goals", "contextual", FEATURES, compute, topics)]


def _counted(goals: list[Goal], now_s: float) -> list[Goal]:
    """Return the goals that ended, or have been under way for longer than any that ended."""
    took_s = [goal.ended_s - goal.accepted_s for goal in goals if goal.ended_s is not None]
    longest_s = max(took_s, default=math.inf)
    return [g for g in goals if g.ended_s is not None or now_s - g.accepted_s > longest_s]


def time_under_way(goals: list[Goal], window: fp.Window) -> float:
    """Return how much of the window had an active goal [s]."""

    def overlap_s(goal: Goal) -> float:
        ended_s = window.end_s if goal.ended_s is None else min(goal.ended_s, window.end_s)
        return max(0.0, ended_s - max(goal.accepted_s, window.start_s))

    return float(sum(map(overlap_s, goals)))


def _time_per_planned_metre(goals: list[Goal], window: fp.Window) -> float | fp.Missing:
    plans = fp.sole_series(window.history["plan"])
    if plans is None:
        return fp.Missing("no plan is recorded")
    time_s = planned_m = 0.0
    for goal in goals:
        if goal.ended_s is None:
            continue
        first, after = np.searchsorted(plans.times_s, (goal.accepted_s, goal.ended_s))
        if first < after:
            time_s += goal.ended_s - goal.accepted_s
            planned_m += float(plans.values[first])
    return time_s / planned_m if planned_m > 0.0 else fp.Missing("no goal that ended had a plan")
