"""Whether ADS-B reports are consistent with radar and with each other.

Reports are compared with the secondary radar's replies of the same address, and with each other: an
aircraft's positions must follow from its reported velocity. Each topic of reports and each aircraft
is judged separately; a column has the worst of them. The position of the antenna is not recorded;
it is estimated robustly from all reports and replies, so that a few false ones do not shift it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.engine.common_fields import header_stamps_s
from oracle_pipeline.features.geometry.scans import Floats, Points
from oracle_pipeline.features.geometry.wgs84 import Site, cartesian
from oracle_pipeline.features.statistics.reduction import largest, mean, quantile, within

_RADAR_FEATURES = (
    fp.Feature("position_residual", "m", 20.0,
        "distance between ADS-B and secondary radar positions, median, maximum over the aircraft",
        "domain"),
    fp.Feature("altitude_residual", "m", 8.0,
        "absolute difference between ADS-B and secondary radar altitudes, median, maximum over the "
        "aircraft", "domain"),
)  # fmt: skip
_REPORT_FEATURES = (
    fp.Feature("velocity_residual", "m/s", 0.5,
        "difference between the reported ground velocity and that of the positions reported over "
        "5 s, median, maximum over the aircraft", "domain"),
    fp.Feature("report_interval", "s", 0.05, "mean time between reports, maximum over the aircraft",
        "domain", timing=True),
    fp.Feature("report_gap", "s", 0.5, "longest time between two reports of an aircraft", "domain",
        timing=True),
    fp.Feature("appearances", "1", 0.5,
        "aircraft that first report far inside the airspace, not at its border or take-off",
        "domain", extensive=True),
    fp.Feature("disappearances", "1", 0.5,
        "aircraft that last report far inside the airspace, not at its border or landing",
        "domain", extensive=True),
)  # fmt: skip

_LAG_S = 5.0  # interval over which positions are differenced
_ANTENNA_STEPS = 4
_GAP_S = 4.0  # longest gap between reports in which positions are interpolated
_SILENT_S = 10.0  # without reports, after which an aircraft has left
# The middle of the air space: this share of its radius, since aircraft come and go at the border,
# and this height above its lowest aircraft, since aircraft take off and land below.
_MIDDLE = 0.6
_ALOFT_M = 600.0


@dataclass(frozen=True, slots=True)
class ReportedFlight:
    """The reports of one address on one topic, in the order of their stamps."""

    times_s: Floats  # recorded at
    stamps_s: Floats  # true at
    latitude: Floats  # [deg]
    longitude: Floats  # [deg]
    altitude_m: Floats
    velocity: Points  # over ground, north + i east [m/s]

    def at(self, stamps_s: Floats) -> tuple[Floats, Floats]:
        """Return Cartesian positions, shape (3, n) [m], and altitudes [m] in between.

        NaN where there are no reports close before and after.
        """
        columns = *cartesian(self.latitude, self.longitude, self.altitude_m), self.altitude_m
        after = np.searchsorted(self.stamps_s, stamps_s)
        last = len(self.stamps_s) - 1
        gap_s = self.stamps_s[np.minimum(after, last)] - self.stamps_s[np.maximum(after - 1, 0)]
        near = (stamps_s >= self.stamps_s[0]) & (stamps_s <= self.stamps_s[-1]) & (gap_s <= _GAP_S)
        *position, altitude = (
            np.where(near, np.interp(stamps_s, self.stamps_s, column), np.nan) for column in columns
        )
        return np.stack(position), altitude


@dataclass(frozen=True, slots=True)
class _Reports:
    """How consistent the reports of a recording are with each other."""

    velocity: dict[str, fp.Series]  # residuals, by topic and aircraft [m/s]
    intervals: dict[str, fp.Series]  # between reports, by topic and aircraft [s]
    begun_s: dict[str, Floats]  # sudden appearances, by topic
    ended_s: dict[str, Floats]


@dataclass(frozen=True, slots=True)
class Replies:
    """The replies of one address to the secondary radar."""

    times_s: Floats  # recorded at
    stamps_s: Floats
    slant_m: Floats
    azimuth: Points  # north + i east, of length 1
    altitude_m: Floats

    def plots(self, up_m: Floats) -> Points:
        """Return positions, north + i east of the antenna [m], given heights above it."""
        return np.sqrt(np.maximum(self.slant_m**2 - up_m**2, 0.0)) * self.azimuth


def _prepare_radar(window: fp.Window) -> dict[str, tuple[fp.Series, fp.Series]] | fp.Missing:
    """Return the residuals of distance and altitude of each reply, by topic and aircraft."""
    replies = _replies(window.topics["replies"])
    pairs = [
        (f"{topic} {address}", flight, replies[address])
        for topic, series in window.topics["reports"].items()
        for address, flight in flights(series).items()
        if address in replies
    ]
    if not pairs:
        return fp.Missing("no aircraft has both ADS-B reports and radar replies")
    compared = [(where, *flight.at(reply.stamps_s), reply) for where, flight, reply in pairs]
    antenna = find_antenna([(position, reply) for _, position, _, reply in compared])
    residuals = {}
    for where, position, altitude_m, reply in compared:
        place, up_m = antenna.seen(position)
        residuals[where] = (
            fp.Series(reply.times_s, np.abs(place - reply.plots(up_m))),
            fp.Series(reply.times_s, np.abs(altitude_m - reply.altitude_m)),
        )
    return residuals


def _compute_radar(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    residuals: dict[str, tuple[fp.Series, fp.Series]] = window.prepared
    none = "no aircraft has both ADS-B reports and radar replies in this window"
    return {
        name: largest(
            {w: quantile(both[column], window, 0.5) for w, both in residuals.items()}, none
        )
        for column, name in enumerate(("position_residual", "altitude_residual"))
    }


def find_antenna(replies: Sequence[tuple[Floats, Replies]]) -> Site:
    """Return the position of the radar that best explains most replies by reported positions.

    Parameters
    ----------
    replies : sequence of (ndarray of shape (3, n), Replies)
        With the reported Cartesian positions at the replies' stamps [m].
    """
    positions = np.concatenate([position for position, _ in replies], axis=1)
    middle = np.nanmedian(positions, axis=1)
    antenna = Site(
        math.degrees(math.atan2(middle[2], math.hypot(middle[0], middle[1]))),
        math.degrees(math.atan2(middle[1], middle[0])),
    )
    for _ in range(_ANTENNA_STEPS):
        offsets = []
        for position, reply in replies:
            place, up_m = antenna.seen(position)
            offsets.append(place - reply.plots(up_m))
        offset = np.concatenate(offsets)
        antenna = antenna.moved(complex(np.nanmedian(offset.real), np.nanmedian(offset.imag)))
    return antenna


def _prepare_reports(window: fp.Window) -> _Reports:
    """Return the consistency of each aircraft's reports with each other."""
    velocity, intervals, begun, ended = {}, {}, {}, {}
    for topic, series in window.topics["reports"].items():
        aircraft = flights(series)
        for address, flight in aircraft.items():
            where = f"{topic} {address}"
            velocity[where] = velocity_residual(flight)
            intervals[where] = fp.Series(flight.times_s[1:], np.diff(flight.stamps_s))
        if aircraft:
            begun[topic], ended[topic] = _sudden(list(aircraft.values()), series.times_s)
    return _Reports(velocity, intervals, begun, ended)


def _compute_reports(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    reports: _Reports = window.prepared
    alone = "no aircraft has two ADS-B reports in this window"
    counts = (
        {topic: float(len(s[within(s, window)])) for topic, s in events.items()}
        for events in (reports.begun_s, reports.ended_s)
    )
    begun, ended = (largest(count, alone) for count in counts)
    return {
        "velocity_residual": largest(
            {w: quantile(s, window, 0.5) for w, s in reports.velocity.items()}, alone
        ),
        "report_interval": largest(
            {w: mean(s, window) for w, s in reports.intervals.items()}, alone
        ),
        "report_gap": largest(
            {w: quantile(s, window, 1.0) for w, s in reports.intervals.items()}, alone
        ),
        "appearances": begun,
        "disappearances": ended,
    }


def velocity_residual(flight: ReportedFlight) -> fp.Series:
    """Return the difference of reported velocity and that of reported positions [m/s]."""
    earlier_s = flight.stamps_s - _LAG_S
    before, _ = flight.at(earlier_s)
    place, _ = Site(flight.latitude, flight.longitude).seen(before)
    reported = flight.velocity + np.interp(earlier_s, flight.stamps_s, flight.velocity)
    return fp.Series(flight.times_s, np.abs(-place / _LAG_S - reported / 2.0))


def _sudden(aircraft: Sequence[ReportedFlight], times_s: Floats) -> tuple[Floats, Floats]:
    """Return when aircraft first and last reported in the middle of the air space [s].

    Parameters
    ----------
    aircraft
        All of a topic.
    times_s
        Of all messages on the topic; aircraft present at its start or end are not counted there.
    """
    latitude, longitude, altitude_m = (
        np.concatenate([getattr(flight, name) for flight in aircraft])
        for name in ("latitude", "longitude", "altitude_m")
    )
    centre = Site(np.median(latitude), np.median(longitude))
    radius_m = np.quantile(np.abs(centre.seen(cartesian(latitude, longitude, 0.0))[0]), 0.99)
    lowest_m = np.quantile(altitude_m, 0.01)

    def in_the_middle(flight: ReportedFlight, end: int) -> bool:
        position = cartesian(flight.latitude[[end]], flight.longitude[[end]], 0.0)
        away_m = abs(centre.seen(position)[0][0])
        return bool(away_m < _MIDDLE * radius_m and flight.altitude_m[end] > lowest_m + _ALOFT_M)

    first_s, last_s = times_s[0] + _SILENT_S, times_s[-1] - _SILENT_S
    begun = [f.times_s[0] for f in aircraft if f.times_s[0] > first_s and in_the_middle(f, 0)]
    ended = [f.times_s[-1] for f in aircraft if f.times_s[-1] < last_s and in_the_middle(f, -1)]
    return np.sort(np.array(begun, dtype=float)), np.sort(np.array(ended, dtype=float))


def flights(series: fp.Series) -> dict[str, ReportedFlight]:
    """Group the reports of a topic by address, without invalid ones."""
    addresses, *columns = zip(*series.values, strict=True)
    table = np.array([series.times_s, *columns])
    of_aircraft = np.isfinite(table).all(axis=0) & (np.abs(table[2]) <= 90.0)
    by_address = {}
    for address, rows in _by_address(addresses, table[1], of_aircraft):
        times_s, stamps_s, latitude, longitude, altitude_m, speed, course_deg = table[:, rows]
        velocity = speed * np.exp(1j * np.radians(course_deg))
        by_address[address] = ReportedFlight(
            times_s, stamps_s, latitude, longitude, altitude_m, velocity
        )
    return by_address


def keep_report(message: Any) -> tuple[Any, ...]:
    """Return address, stamp, position, ground speed and track of an ``AdsbReport``."""
    return (
        message.icao24, header_stamps_s(message), message.latitude, message.longitude,
        message.altitude_m, message.ground_speed, message.track_deg,
    )  # fmt: skip


def keep_reply(message: Any) -> tuple[Any, ...]:
    """Return address, stamp, slant range, azimuth and altitude of a ``SecondaryReply``."""
    return (
        message.icao24, header_stamps_s(message), message.slant_range_m, message.azimuth_deg,
        message.altitude_m,
    )  # fmt: skip


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of aircraft's reports."""
    reports = {"reports": fp.Request(keep_report, msgtype="atc_msgs/msg/AdsbReport", dtype=object)}
    replies = {
        "replies": fp.Request(keep_reply, msgtype="atc_msgs/msg/SecondaryReply", dtype=object)
    }
    return [
        fp.FeaturePlugin(
            "atc_radar", "atc", _RADAR_FEATURES, _compute_radar, reports | replies,
            prepare=_prepare_radar,
        ),
        fp.FeaturePlugin(
            "atc_reports", "atc", _REPORT_FEATURES, _compute_reports, reports,
            prepare=_prepare_reports,
        ),
    ]  # fmt: skip


def _replies(topics: Mapping[str, fp.Series]) -> dict[str, Replies]:
    """Group the replies of all topics by address; of an address on two topics, the last counts."""
    by_address = {}
    for series in topics.values():
        addresses, *columns = zip(*series.values, strict=True)
        table = np.array([series.times_s, *columns])
        for address, rows in _by_address(addresses, table[1], np.isfinite(table).all(axis=0)):
            times_s, stamps_s, slant_m, azimuth_deg, altitude_m = table[:, rows]
            azimuth = np.exp(1j * np.radians(azimuth_deg))
            by_address[address] = Replies(times_s, stamps_s, slant_m, azimuth, altitude_m)
    return by_address


def _by_address(
    addresses: Sequence[str], stamps_s: Floats, chosen: NDArray[np.bool_]
) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Yield each address and the indices of its chosen rows, by their stamps."""
    names, number = np.unique(np.array(addresses), return_inverse=True)
    for index, name in enumerate(names.tolist()):
        rows = np.flatnonzero((number == index) & chosen)
        if rows.size:
            yield name, rows[np.argsort(stamps_s[rows], kind="stable")]
