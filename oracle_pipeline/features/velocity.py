"""Velocity commands, and the share of them that the collision monitor passed.

Nav2's collision monitor takes the requested command (``/cmd_vel_raw`` in Humble,
``/cmd_vel_smoothed`` since Iron) and answers each on ``/cmd_vel``. After the robot has stood still
for a while, it stops answering.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.plugin import (
    Feature,
    FeaturePlugin,
    Missing,
    Request,
    Series,
    Values,
    Window,
    hookimpl,
)
from oracle_pipeline.features.reduction import mean
from oracle_pipeline.features.scans import Floats
from oracle_pipeline.robots.roles import COMMAND, REQUESTED_COMMAND

MONITOR_FEATURES = (
    Feature(
        "monitor_stopped", "1", 0.01,
        "share of the commands to move that the collision monitor turned into a stop", "navigation",
        behaviour=True,
    ),
    Feature(
        "monitor_slowed", "1", 0.01, "share of the commands to move that it slowed down",
        "navigation", behaviour=True,
    ),
)  # fmt: skip
COMMAND_FEATURES = (
    Feature(
        "command_zero", "1", 0.01, "share of the commands that are zero", "navigation",
        behaviour=True,
    ),
    Feature(
        "command_reversals", "1/min", 0.5,
        "how often the commanded turn changes its direction, a minute of commands", "navigation",
        behaviour=True,
    ),
    Feature(
        "command_jerk", "m/s^3", 0.1, "mean absolute jerk of the commanded speed", "navigation",
        behaviour=True,
    ),
    Feature(
        "command_angular_jerk", "rad/s^3", 0.5, "mean absolute jerk of the commanded turn",
        "navigation", behaviour=True,
    ),
)  # fmt: skip

_STILL = 1e-3  # smaller speeds [m/s] and turns [rad/s] count as zero
_ANSWER_S = 0.1  # longest delay of the monitor's output
_SLOWED = 0.95  # share of a command; with less, it was slowed down


def keep(messages: Any) -> tuple[Floats, Floats]:
    """Return speed [m/s] and turn [rad/s] of Twists, with or without a header."""
    twist = getattr(messages, "twist", messages)
    return twist.linear.x, twist.angular.z


def prepare_monitor(window: Window) -> Series:
    """Return the share of each command to move that the wheels got."""
    (requested,) = window.topics["requested"].values()
    (commands,) = window.topics["commands"].values()
    return passed(requested, commands)


def compute_monitor(window: Window) -> Values | Missing:
    """Count what was stopped and slowed down."""
    times_s, share = window.prepared
    stopped = mean(Series(times_s, (share == 0.0).astype(float)), window)
    slowed = mean(Series(times_s, ((share > 0.0) & (share < _SLOWED)).astype(float)), window)
    if np.isnan(stopped):
        return Missing("no command to move")
    return {"monitor_stopped": stopped, "monitor_slowed": slowed}


def passed(asked: Series, answers: Series) -> Series:
    """Return how much of each command to move was sent on: 1 all, 0 nothing or no answer."""
    size = np.hypot(*asked.values.T)
    moving = size > _STILL
    times_s, size = asked.times_s[moving], size[moving]
    next_answer = np.searchsorted(answers.times_s, times_s)
    index = np.minimum(next_answer, len(answers.times_s) - 1)
    answered = (next_answer == index) & (answers.times_s[index] - times_s <= _ANSWER_S)
    sent = np.where(answered, np.hypot(*answers.values[index].T), 0.0)
    return Series(times_s, np.where(sent > _STILL, sent / size, 0.0))


def compute_commands(window: Window) -> Values | Missing:
    """Compute from the commands in the window."""
    ((times_s, commands),) = window.topics["commands"].values()
    if len(times_s) < 3:
        return Missing("fewer than three commands")
    interval_s = float(np.median(np.diff(times_s)))
    if interval_s <= 0.0:
        return Missing("all commands came at once")
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


@hookimpl
def register_features() -> list[FeaturePlugin]:
    """Offer the features of velocity commands."""
    commands = {"commands": Request(keep, role=COMMAND, many=True)}
    requested = {"requested": Request(keep, role=REQUESTED_COMMAND, many=True)}
    return [
        FeaturePlugin(
            "collision_monitor", "navigation", MONITOR_FEATURES, compute_monitor,
            commands | requested, prepare=prepare_monitor,
        ),
        FeaturePlugin("commands", "navigation", COMMAND_FEATURES, compute_commands, commands),
    ]  # fmt: skip
