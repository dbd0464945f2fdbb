"""A trace: a few signals of a recording over time, sampled on one clock.

Rule-based oracles need signals, not features: the commanded speed, the nearest return of a scanner,
the number of quiet topics. Signals are found by the roles of topics, so they have the same names on
every robot. Signals that a robot does not record are NaN. A file of requirements may name further
ones: any number in the messages.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.kept_messages import NO_GRAPH, KeptMessages
from oracle_pipeline.features.engine.spans import Span
from oracle_pipeline.features.motion.velocity import keep as keep_command
from oracle_pipeline.features.navigation.goals import GOAL_TOPICS, goals_so_far
from oracle_pipeline.features.signals.collector import SignalCollector
from oracle_pipeline.robots.robot import Robot
from oracle_pipeline.robots.roles import COMMAND, IMU, ODOMETRY, POSE, SCAN

STEP_S = 0.05  # between two samples: Nav2 commands at 20 Hz
TIME = "time_s"

_ERROR = 40  # level of rcl_interfaces/msg/Log
_SAMPLED_S = 0.05  # one message of an inertial unit is read per such span
_PERIODIC_S = 1.0  # largest median time between messages of a periodic topic
_FEWEST = 20  # messages needed to call a topic periodic
_QUIET_S, _QUIET_PERIODS = 2.0, 20.0  # a topic is quiet after the longer of the two

NO_NUMBERS: Mapping[str, str] = MappingProxyType({})
RATE = "_rate"  # suffix for the change of a signal over the last second

Floats = NDArray[np.float64]


class Signal(NamedTuple):
    """One column of a trace."""

    unit: str
    floor: float  # smallest significant difference, in the unit


_TABLE = Path(__file__).with_name("signals.csv")

#: All signals, by name; ``signals.csv`` describes them.
SIGNALS: Mapping[str, Signal] = {
    name: Signal(unit, floor)
    for name, unit, floor in pd.read_csv(_TABLE, usecols=range(3)).itertuples(index=False)
}


def known_names(further: Iterable[str] = ()) -> list[str]:
    """Return the names that formulas may use: all signals, further ones, and their rates."""
    names = [*SIGNALS, *further]
    return [*names, *(f"{name}{RATE}" for name in names)]


def values_of(trace: pd.DataFrame, names: Sequence[str]) -> Floats:
    """Return signals and rates of a trace, shape (n_times, n_names); NaN where unknown."""
    columns = []
    for name in names:
        values = trace[name if name in trace else name.removesuffix(RATE)].to_numpy(np.float64)
        columns.append(values if name in trace else _changes(values))
    return np.column_stack(columns)


def _changes(values: Floats) -> Floats:
    """Return the change of values over the last second."""
    steps = round(1.0 / STEP_S)
    changes = np.full(len(values), np.nan)
    changes[steps:] = values[steps:] - values[:-steps]
    return changes


def _keep_odometry(messages: Any) -> tuple[Floats, ...]:
    position, twist = messages.pose.pose.position, messages.twist.twist
    return position.x, position.y, twist.linear.x, twist.angular.z


def _keep_inertial(messages: Any) -> tuple[Floats, Floats]:
    a = messages.linear_acceleration
    return messages.angular_velocity.z, np.sqrt(a.x * a.x + a.y * a.y + a.z * a.z)


def _keep_poses(messages: Any) -> tuple[Floats, Floats, Floats]:
    position, variance = messages.pose.pose.position, messages.pose.covariance
    return position.x, position.y, np.sqrt(np.maximum(0.0, variance[:, 0] + variance[:, 7]))


def _keep_scans(messages: Any) -> Floats:
    """Return the nearest return [m], the share of rays without one, and the unevenness [m].

    The unevenness is the median of the second differences between neighbouring rays.
    """
    kept = np.full((len(messages.ranges), 3), np.nan)
    lengths = np.array([len(ranges) for ranges in messages.ranges])
    for length in np.unique(lengths[lengths > 0]):
        rows = np.flatnonzero(lengths == length)
        ranges = np.stack(list(messages.ranges[rows])).astype(np.float64)
        least, most = (limit[rows, None] for limit in (messages.range_min, messages.range_max))
        valid = (ranges >= least) & (ranges <= most)
        together = valid[:, 2:] & valid[:, 1:-1] & valid[:, :-2]
        with np.errstate(invalid="ignore"):  # infinite ranges are not valid
            bends = np.abs(ranges[:, :-2] - 2.0 * ranges[:, 1:-1] + ranges[:, 2:])
        nearest = np.where(valid, ranges, np.inf).min(axis=1)
        kept[rows, 0] = np.where(valid.any(axis=1), nearest, np.nan)
        kept[rows, 1] = 1.0 - valid.mean(axis=1)
        kept[rows, 2] = _medians(np.where(together, bends, np.nan))
    return kept


def _medians(rows: Floats) -> Floats:
    """Return the median of the numbers in each row; NaN without any."""
    counts, ordered = np.count_nonzero(~np.isnan(rows), axis=1), np.sort(rows, axis=1)  # NaN last
    medians, known = np.full(len(rows), np.nan), np.flatnonzero(counts)
    low, high = (counts[known] - 1) // 2, counts[known] // 2
    medians[known] = (ordered[known, low] + ordered[known, high]) / 2.0
    return medians


#: The topics of a trace, requested as a plugin without features.
TRACE = fp.FeaturePlugin(
    "trace", "trace", (), lambda _: fp.Missing("a trace has no features"),
    GOAL_TOPICS | {
        "command": fp.Request(keep_command, role=COMMAND, optional=True, many=True),
        "odometry": fp.Request(_keep_odometry, role=ODOMETRY, optional=True, many=True),
        "inertial": fp.Request(
            _keep_inertial, role=IMU, optional=True, every_s=_SAMPLED_S, many=True
        ),
        "pose": fp.Request(_keep_poses, role=POSE, optional=True, many=True),
        "scans": fp.Request(_keep_scans, role=SCAN, optional=True, many=True),
        "logged": fp.Request(
            lambda messages: messages.level, msgtype="rcl_interfaces/msg/Log", optional=True,
            many=True,
        ),
    },
)  # fmt: skip


def read_trace(robot: Robot, numbers: Mapping[str, str] = NO_NUMBERS) -> pd.DataFrame:
    """Read the signals of one robot, in one pass over its bag.

    Parameters
    ----------
    robot : Robot
    numbers : mapping of str to str
        Further signals, and the number in messages that each is, such as ``/battery/voltage``.

    Returns
    -------
    DataFrame
        That of `trace_of`, with a column for each further signal.

    Raises
    ------
    BagError
        The bag cannot be read to its end.
    """
    collector = SignalCollector(robot, {number.rpartition("/")[0] for number in numbers.values()})
    recording = KeptMessages.read(robot, (TRACE,), see=collector.see)
    trace = trace_of(recording)
    found = {
        f"{part.topic}/{name}": fp.Series(part.times_ns.astype(np.float64) * 1e-9, values[:, None])
        for part in collector.signals(recording.times_ns)
        if len(part.times_ns)  # one message has no period
        for name, values in zip(part.names, part.values.T, strict=True)
    }
    unknown = fp.Series(np.zeros(1), np.full((1, 1), np.nan))
    clock = trace[TIME].to_numpy()
    further = {name: _held(found.get(each, unknown), clock)[0] for name, each in numbers.items()}
    return pd.DataFrame({**trace, **further})


def all_numbers(robot: Robot) -> dict[str, str]:
    """Return all finite numbers in a robot's messages, by names for formulas."""
    collector = SignalCollector(robot)
    recording = KeptMessages.read(robot, (), see=collector.see)
    parts = collector.signals(recording.times_ns)
    numbers = [
        f"{part.topic}/{name}"
        for part in parts
        for name, values in zip(part.names, part.values.T, strict=True)
        if np.isfinite(values).any()
    ]
    return {re.sub(r"\W+", "_", number).strip("_"): number for number in numbers}


def trace_of(recording: KeptMessages) -> pd.DataFrame:
    """Return the signals of a recording that was read for `TRACE`, and maybe other plugins.

    Returns
    -------
    DataFrame
        Columns ``time_s`` (every 0.05 s from the start of the recording) and all of `SIGNALS`;
        a signal holds its last value, and is NaN before its first.
    """
    whole = Span(0, recording.clock.duration_ns)
    window = recording.usable(TRACE, whole, recording.span(whole, NO_GRAPH))
    clock = np.arange(0.0, whole.end_s, STEP_S)
    columns = {name: np.full(len(clock), np.nan) for name in SIGNALS}
    columns.update(signals(window, clock))
    return pd.DataFrame({TIME: clock, **columns})


def signals(window: fp.Window, clock: Floats) -> dict[str, Floats]:
    """Return the signals that a recording has, sampled at the times of a clock [s]."""
    found: dict[str, Floats] = {}
    for part in (_driven, _sensed, _scanned, _navigated, _logged):
        found.update(part(window, clock))
    moving = ("command", "odometry", "inertial", "pose")
    broken = [
        series.times_s[~np.isfinite(series.values).all(axis=1)]
        for key in moving
        for series in window.topics[key].values()
    ]
    found["non_finite"] = _cumulative_count(np.concatenate([np.zeros(0), *broken]), clock)
    found["quiet_topics"] = quiet_topics(window.arrivals, clock)
    return found


def quiet_topics(arrivals: Mapping[str, fp.TopicArrivals], clock: Floats) -> Floats:
    """Return the number of periodic topics that have been silent for too long, at each time."""
    quiet = np.zeros(len(clock))
    for arrived in arrivals.values():
        times_s = arrived.times_s
        if len(times_s) < _FEWEST:
            continue
        period_s = float(np.median(np.diff(times_s)))
        if period_s > _PERIODIC_S:
            continue
        limit_s = max(_QUIET_S, _QUIET_PERIODS * period_s)
        last = np.searchsorted(times_s, clock, side="right") - 1
        quiet += (last >= 0) & (clock - times_s[np.maximum(last, 0)] > limit_s)
    return quiet


def _driven(window: fp.Window, clock: Floats) -> Iterator[tuple[str, Floats]]:
    if (commands := fp.sole_series(window.topics["command"])) is not None:
        yield from zip(("command_speed", "command_turn"), _held(commands, clock), strict=True)
    if (odometry := fp.sole_series(window.topics["odometry"])) is not None:
        x, y, speed, turn = _held(odometry, clock)
        yield "speed", speed
        yield "turn", turn
        steps = np.hypot(np.diff(x, prepend=x[:1]), np.diff(y, prepend=y[:1]))
        yield "travelled", np.where(np.isnan(x), np.nan, np.nancumsum(steps))


def _sensed(window: fp.Window, clock: Floats) -> Iterator[tuple[str, Floats]]:
    if (inertial := fp.sole_series(window.topics["inertial"])) is not None:
        yield from zip(("gyro_turn", "acceleration"), _held(inertial, clock), strict=True)
    if (poses := fp.sole_series(window.topics["pose"])) is not None:
        yield "pose_spread", _held(poses, clock)[2]
        if (odometry := fp.sole_series(window.topics["odometry"])) is not None:
            by_odometry = _held(odometry, poses.times_s)[:2].T
            jumps = np.abs(_strides(poses.values[:, :2]) - _strides(by_odometry))
            yield "pose_jump", _held(fp.Series(poses.times_s, jumps[:, None]), clock)[0]


def _scanned(window: fp.Window, clock: Floats) -> Iterator[tuple[str, Floats]]:
    scans = window.topics["scans"]
    if not scans:
        return
    of_all = np.array([_held(series, clock) for series in scans.values()])
    for number, name in enumerate(("nearest", "no_return", "uneven")):
        known = ~np.isnan(of_all[:, number])
        for end, fill, best in (("min", np.inf, np.min), ("max", -np.inf, np.max)):
            value = best(np.where(known, of_all[:, number], fill), axis=0)
            yield f"{name}_{end}", np.where(known.any(axis=0), value, np.nan)


def _navigated(window: fp.Window, clock: Floats) -> Iterator[tuple[str, Floats]]:
    goals = goals_so_far(window)
    if isinstance(goals, fp.Missing):
        return
    time_s = np.zeros(len(clock))
    for goal in goals:
        end_s = np.inf if goal.ended_s is None else goal.ended_s
        under_way = (clock >= goal.accepted_s) & (clock < end_s)
        time_s[under_way] = clock[under_way] - goal.accepted_s
    failed = [g.ended_s for g in goals if g.ended_s is not None and not g.reached]
    yield "goal_time", time_s
    yield "goals_failed", _cumulative_count(np.array(failed, dtype=np.float64), clock)


def _logged(window: fp.Window, clock: Floats) -> Iterator[tuple[str, Floats]]:
    logs = window.topics["logged"].values()
    if logs:
        bad = [series.times_s[series.values >= _ERROR] for series in logs]
        yield "errors", _cumulative_count(np.concatenate(bad), clock)


def _held(series: fp.Series, clock: Floats) -> Floats:
    """Return the last value at each time, shape (n_values, n_times); NaN before the first."""
    last = np.searchsorted(series.times_s, clock, side="right") - 1
    values = np.where(np.isfinite(series.values), series.values, np.nan)
    return np.where(last >= 0, values[np.maximum(last, 0)].T, np.nan)


def _strides(points: Floats) -> Floats:
    """Return the distance of each point from the one before it; 0 for the first."""
    return np.asarray(np.hypot(*np.diff(points, axis=0, prepend=points[:1]).T), dtype=np.float64)


def _cumulative_count(times_s: Floats, clock: Floats) -> Floats:
    """Return the cumulative number of events at each time."""
    return np.searchsorted(np.sort(times_s), clock, side="right").astype(np.float64)
