"""Velocity commands, and the share of them that the collision monitor passed.

Nav2's collision monitor takes the requested command (``/cmd_vel_raw`` in Humble,
``/cmd_vel_smoothed`` since Iron) and answers each on ``/cmd_vel``. After the robot has stood still
for a while, it stops answering.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.geometry.scans import Floats
from oracle_pipeline.features.statistics.reduction import mean
from oracle_pipeline.robots.roles import COMMAND, REQUESTED_COMMAND

_MONITOR_FEATURES = (
    fp.Feature("monitor_stopped", "1", 0.01,
        "share of non-zero velocity commands that the collision monitor stopped", "navigation",
        behaviour=True),
    fp.Feature("monitor_slowed", "1", 0.01,
        "share of non-zero velocity commands that the collision monitor slowed down", "navigation",
        behaviour=True),
    fp.Feature("monitor_altered", "1", 0.01,
        "share of non-zero velocity commands whose output is not a fraction of the command",
        "navigation"),
)  # fmt: skip
_COMMAND_FEATURES = fp.timed(
    fp.Feature(
        "command_zero", "1", 0.05, "share of the velocity commands that are zero", "navigation",
        behaviour=True,
    ),
    fp.Feature("command_reversals", "1/min", 6.0,
        "sign changes of the commanded angular velocity per minute of commands", "navigation",
        behaviour=True),
    fp.Feature("command_jerk", "m/s^3", 1.0, "mean absolute jerk of the commanded linear velocity",
        "navigation",
        behaviour=True),
    fp.Feature("command_angular_jerk", "rad/s^3", 0.5, "mean absolute angular jerk of the commands",
        "navigation", behaviour=True),
)  # fmt: skip

_STILL = 1e-3  # smaller speeds [m/s] and turns [rad/s] count as zero
_ANSWER_S = 0.1  # longest delay of the monitor's output
_SLOWED = 0.95  # share of a command; with less, it was slowed down
_ALTERED = 5e-3  # difference from any fraction of a command [m/s, rad/s]


def keep(messages: Any) -> tuple[Floats, Floats]:
    """Return speed [m/s] and turn [rad/s] of Twists, with or without a header."""
    twist = getattr(messages, "twist", messages)
    return twist.linear.x, twist.angular.z


class Answers(NamedTuple):
    """What the collision monitor made of each non-zero command; shape (n,) each."""

    share: fp.Series  # of the command that was sent on: 1 all, 0 nothing or no answer
    altered: fp.Series  # whether something else than a fraction of it was sent


def _prepare_monitor(window: fp.Window) -> Answers:
    """Compare each non-zero command with the monitor's output."""
    (requested,) = window.topics["requested"].values()
    (commands,) = window.topics["commands"].values()
    return answers_of(requested, commands)


def _compute_monitor(window: fp.Window) -> fp.Values | fp.Missing:
    """Count what was stopped, slowed down and altered."""
    (times_s, share), altered = window.prepared
    stopped = mean(fp.Series(times_s, (share == 0.0).astype(float)), window)
    slowed = mean(fp.Series(times_s, ((share > 0.0) & (share < _SLOWED)).astype(float)), window)
    if np.isnan(stopped):
        return fp.Missing("no non-zero velocity command")
    return {
        "monitor_stopped": stopped,
        "monitor_slowed": slowed,
        "monitor_altered": mean(altered, window),
    }


def answers_of(asked: fp.Series, answers: fp.Series) -> Answers:
    """Compare each non-zero command with the next output within `_ANSWER_S`."""
    size = np.hypot(*asked.values.T)
    moving = size > _STILL
    times_s, size, command = asked.times_s[moving], size[moving], asked.values[moving]
    next_answer = np.searchsorted(answers.times_s, times_s)
    index = np.minimum(next_answer, len(answers.times_s) - 1)
    answered = (next_answer == index) & (answers.times_s[index] - times_s <= _ANSWER_S)
    output = np.where(answered[:, None], answers.values[index], 0.0)
    sent = np.hypot(*output.T)
    fraction = np.clip((output * command).sum(axis=1) / size**2, 0.0, 1.0)
    beside = np.abs(output - fraction[:, None] * command).max(axis=1)
    return Answers(
        fp.Series(times_s, np.where(sent > _STILL, sent / size, 0.0)),
        fp.Series(times_s, (beside > _ALTERED).astype(float)),
    )


def _compute_commands(window: fp.Window) -> fp.Values | fp.Missing:
    """Compute from the commands in the window."""
    ((times_s, commands),) = window.topics["commands"].values()
    if len(times_s) < 3:
        return fp.Missing("fewer than three velocity commands")
    intervals_s = np.diff(times_s)
    together = intervals_s <= 2.0 * np.median(intervals_s)  # without the pauses between goals
    interval_s = float(intervals_s[together].mean())
    if interval_s <= 0.0:
        return fp.Missing("the velocity commands have no time between them")
    jerk, angular_jerk = np.abs(np.diff(commands, 2, axis=0)).mean(axis=0) / interval_s**2
    return {
        "command_zero": float((np.abs(commands) <= _STILL).all(axis=1).mean()),
        "command_reversals": reversals(commands[:, 1]) * 60.0 / (len(times_s) * interval_s),
        "command_jerk": float(jerk),
        "command_angular_jerk": float(angular_jerk),
    }


def reversals(turn: NDArray[np.float64]) -> int:
    """Count the changes of sign, whatever zeros are in between."""
    sign = np.sign(turn[np.abs(turn) > _STILL])
    return int(np.count_nonzero(np.diff(sign)))


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of velocity commands."""
    commands = {"commands": fp.Request(keep, role=COMMAND, many=True)}
    requested = {"requested": fp.Request(keep, role=REQUESTED_COMMAND, many=True)}
    return [
        fp.FeaturePlugin(
            "collision_monitor", "navigation", _MONITOR_FEATURES, _compute_monitor,
            commands | requested, prepare=_prepare_monitor,
        ),
        fp.FeaturePlugin("commands", "navigation", _COMMAND_FEATURES, _compute_commands, commands),
    ]  # fmt: skip
