"""Whether a sensor's messages have the same delay after their stamps as those of other sensors.

Messages that are held back, processed or stamped again arrive later, earlier or less regularly.
Latencies are relative to the freshest sensor of the recording, so the start of the recorder's clock
does not matter.
"""

import math
from collections.abc import Mapping

import numpy as np

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.geometry.scans import Floats
from oracle_pipeline.features.statistics.reduction import largest, median_and_deviation
from oracle_pipeline.robots.roles import SCAN

SENSORS = {
    "scan": "sensor_msgs/msg/LaserScan",
    "odometry": "nav_msgs/msg/Odometry",
    "inertial": "sensor_msgs/msg/Imu",
    "joints": "sensor_msgs/msg/JointState",
}
FEATURES = fp.timed(
    *(
        fp.Feature(
            f"{name}_latency", "s", 5e-3,
            f"latency, from stamp to recording, of {msgtype.rpartition('/')[2]} messages relative "
            "to the sensor with the lowest latency, median, maximum over the topics", "domain",
        )
        for name, msgtype in SENSORS.items()
    ),
    *(
        fp.Feature(
            f"{name}_jitter", "s", 5e-3,
            f"median absolute deviation of the latency of {msgtype.rpartition('/')[2]} messages, "
            "maximum over the topics", "domain",
        )
        for name, msgtype in SENSORS.items()
    ),
    fp.Feature("period_jitter", "1", 0.01,
        "median absolute deviation of the time between stamps over its median, maximum over the "
        "topics of sensors", "domain"),
    fp.Feature("late", "1", 0.05,
        "share of the messages whose latency is a period, and 25 ms, or more above the topic's "
        "median, maximum over the topics of sensors", "domain"),
)  # fmt: skip

_KINDS = {msgtype: name for name, msgtype in SENSORS.items()}
_FEWEST = 5  # messages of a compared topic
_MOST_JITTER = 10.0  # two publishers may leave a nanosecond between their stamps
_LATE_S = 0.025  # more than a recorder or a loaded machine holds messages
_ANOTHER_CLOCK_S = 3600.0  # least difference of stamps that are of another clock, or not set


def compute(window: fp.Window) -> fp.Values | fp.Missing:
    """Compare the sensors of the window."""
    held = {
        topic: _held_s(each)
        for topic, each in window.arrivals.items()
        if len(each.header_stamps_ns) >= _FEWEST and _sensor(topic, window)
    }
    if not held:
        return fp.Missing("too few messages of sensors with header stamps")
    held = _over_the_freshest(held, window.arrivals)
    spreads = {topic: median_and_deviation(each) for topic, each in held.items()}
    held = {t: each for t, each in held.items() if abs(spreads[t][0]) < _ANOTHER_CLOCK_S}
    usual = {topic: each[0] for topic, each in spreads.items()}
    values: dict[str, float | fp.Located | fp.Missing] = {}
    for name, msgtype in SENSORS.items():
        topics = [topic for topic in held if _sensor(topic, window) == name]
        none = f"too few {msgtype} messages with header stamps"
        values[f"{name}_latency"] = largest({t: usual[t] for t in topics}, none)
        values[f"{name}_jitter"] = largest({t: spreads[t][1] for t in topics}, none)
    periods = {topic: _period(window.arrivals[topic]) for topic in held}
    values["period_jitter"] = largest(
        {t: each[1] for t, each in periods.items()}, "the header stamps do not increase"
    )
    values["late"] = largest(
        {
            topic: float(np.mean(each - usual[topic] >= np.maximum(periods[topic][0], _LATE_S)))
            for topic, each in held.items()
        },
        "the header stamps do not increase",
    )
    return values


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of stamps."""
    return [fp.FeaturePlugin("stamps", "stamps", FEATURES, compute)]


def _sensor(topic: str, window: fp.Window) -> str:
    """Return the kind of sensor of a topic; empty without one."""
    if window.roles.has(SCAN, topic):
        return "scan"
    return _KINDS.get(window.arrivals[topic].msgtype, "")


def _over_the_freshest(
    held: Mapping[str, Floats], arrivals: Mapping[str, fp.TopicArrivals]
) -> dict[str, Floats]:
    """Return the delays from stamp to recording minus those of the freshest sensor at that time.

    The clocks of recorder and stamps may differ in rate, as with a slow simulator, but equally for
    all sensors. The freshest sensor itself is compared with a linear fit.
    """
    freshest = min(held, key=lambda topic: (median_and_deviation(held[topic])[0], topic))
    times_s = arrivals[freshest].times_s
    common = held[freshest]
    if times_s[-1] > times_s[0]:
        common = _fitted_line(times_s, held[freshest])
    return {
        topic: each
        - (
            common
            if topic == freshest
            else np.interp(arrivals[topic].times_s, times_s, held[freshest])
        )
        for topic, each in held.items()
    }


@jit
def _fitted_line(x: Floats, y: Floats) -> Floats:
    """Return the values at x of the line through points that has the least squares."""
    away_x, away_y = x - x[0], y - y[0]  # small numbers, as stamps may count from 1970
    from_mean = away_x - away_x.mean()
    middle = away_y.mean()
    slope = (from_mean * (away_y - middle)).sum() / (from_mean * from_mean).sum()
    fitted: Floats = y[0] + (middle + slope * from_mean)
    return fitted


def _held_s(arrivals: fp.TopicArrivals) -> Floats:
    """Return the delay from stamp to recording, up to a constant of the recording [s]."""
    stamps_ns = arrivals.header_stamps_ns
    return arrivals.times_s - stamps_ns.astype(np.float64) / 1e9


def _period(arrivals: fp.TopicArrivals) -> tuple[float, float]:
    """Return the median time between stamps [s], and its relative deviation; NaN if it is 0."""
    stamps_ns = arrivals.header_stamps_ns
    period_s, deviation_s = median_and_deviation((stamps_ns[1:] - stamps_ns[:-1]) / 1e9)
    if period_s <= 0.0:
        return math.inf, math.nan
    return period_s, min(deviation_s / period_s, _MOST_JITTER)
