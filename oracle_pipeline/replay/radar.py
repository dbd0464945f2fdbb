"""The radar display of an air traffic recording: tracks, reports and plots around the antenna.

The position of the antenna is estimated with ``oracle_pipeline.features.air_traffic.adsb_reports``.
"""

import cmath
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Circle
from numpy.typing import NDArray

from oracle_pipeline.features.air_traffic.adsb_reports import (
    Replies,
    ReportedFlight,
    find_antenna,
    flights,
    keep_reply,
    keep_report,
)
from oracle_pipeline.features.engine.plugin import Series
from oracle_pipeline.features.geometry.wgs84 import Site, cartesian
from oracle_pipeline.opened_run import OpenedRun
from oracle_pipeline.reporting.figures import AMBER, COLORS, INK, drawing
from oracle_pipeline.reporting.stored_report import ReportError

TRACKS, REPORT = "atc_msgs/msg/TrackArray", "atc_msgs/msg/AdsbReport"
ECHO, REPLY = "atc_msgs/msg/RadarPlot", "atc_msgs/msg/SecondaryReply"
INSTANT = 0.25  # share of the recording; at 0.5, flights of our testbed meet over the antenna
HISTORY_S = 120.0  # shown time before the instant
RING_KM = 20.0
AHEAD_S = 60.0  # length of a track's prediction
FLIGHT_LEVEL_M = 30.48
# Offsets of labels from their tracks, alternating from west to east to avoid overlaps [points].
LABELS = ((6, 6), (6, -13), (6, 17), (6, -24))

_ADSB = 1  # in the sources of a track
_INKS: dict[str, dict[str, Any]] = {
    "seen by both": {"color": COLORS["normal"], "marker": "o"},
    "radar alone": {"color": AMBER, "marker": "s"},
    "ADS-B alone": {"color": COLORS["malicious"], "marker": "^"},
}


@dataclass(frozen=True, eq=False, slots=True)
class _RadarTrack:
    """One track of the fusion; positions are north + i east of the antenna [km]."""

    label: str
    seen_by: str  # a key of the legend
    trail: NDArray[np.complex128]  # (n,), the newest last
    ahead: complex  # predicted displacement in a minute


@dataclass(frozen=True, eq=False, slots=True)
class _Display:
    """The display at one instant; positions are north + i east of the antenna [km]."""

    title: str
    tracks: Sequence[_RadarTrack]
    reports: NDArray[np.complex128]  # (n,), of the last two minutes
    plots: NDArray[np.complex128]  # (m,), of both radars in the last two minutes


def has_tracks(run: OpenedRun) -> bool:
    """Return whether a recording has air traffic tracks."""
    return TRACKS in {topic.msgtype for topic in run.bag.topics.values()}


def radar_display(run: OpenedRun) -> _Display:
    """Return the display after a quarter of a recording.

    Raises
    ------
    ReportError
        There is no track at that time.
    BagError
        The bag cannot be read.
    """
    instant_s = INSTANT * run.duration_s
    messages = _messages(run, instant_s)
    if not messages[TRACKS] or not messages[TRACKS][-1].tracks:
        raise ReportError(f"{run.path} cannot be drawn: there is no track a quarter through it.")
    antenna = _antenna(messages)
    reports = [(m.latitude, m.longitude, m.altitude_m) for m in messages[REPORT]]
    plots = [_plot(m, getattr(m, "altitude_m", 0.0)) for m in (*messages[ECHO], *messages[REPLY])]
    name = run.path.resolve().name
    if run.manifest is not None:
        name = run.manifest.key
    return _Display(
        f"{name}, {instant_s:.0f} s",
        _tracks(messages[TRACKS], antenna),
        _places(reports, antenna),
        np.array(plots, dtype=np.complex128),
    )


def plan_view(display: _Display) -> bytes:
    """Draw the display as PNG, in the style of ``reporting.figures``; north is up."""
    trails = np.concatenate([track.trail for track in display.tracks])
    reach = RING_KM * math.ceil(float(np.abs(trails).max()) / RING_KM)
    with drawing(4.7, 5.2) as (axes, png):
        _draw_rings(axes, reach)
        dots: dict[str, Any] = {"marker": "o", "ls": "", "mew": 0}
        teal = to_rgba(COLORS["control"], 0.35)
        axes.plot(*_xy(display.reports), ms=3.2, label="ADS-B report", color=teal, **dots)
        axes.plot(*_xy(display.plots), ms=1.8, label="radar plot", color=INK, **dots)
        eastwards = sorted(display.tracks, key=lambda track: track.trail[-1].imag)
        for track, place in zip(eastwards, cycle(LABELS), strict=False):
            ink, now = _INKS[track.seen_by], track.trail[-1]
            axes.plot(*_xy(track.trail), color=ink["color"], lw=0.6)
            axes.plot(*_xy(np.array([now, now + track.ahead])), color=ink["color"], lw=1.2)
            axes.plot(*_xy(now), ls="", ms=6, **ink)
            axes.annotate(
                track.label, _xy(now), place, textcoords="offset points", fontsize="x-small",
                color=ink["color"],
            )  # fmt: skip
        for seen_by, ink in _INKS.items():
            axes.plot([], [], ls="", label=seen_by, **ink)
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        axes.set(xlabel="east of the radar [km]", ylabel="north of the radar [km]")
        axes.set_title(display.title)
        axes.figure.legend(loc="outside lower center", ncols=3, fontsize="small", markerscale=1.2)
    return png.getvalue()


def _messages(run: OpenedRun, instant_s: float) -> Mapping[str, list[Any]]:
    """Return the messages of the history, by type."""
    types = {name: topic.msgtype for name, topic in run.bag.topics.items()}
    wanted = {name for name, of in types.items() if of in (TRACKS, REPORT, ECHO, REPLY)}
    messages = defaultdict(list)
    for raw in run.bag.messages(wanted):
        time_s = (raw.stamp_ns - run.bag.start_ns) * 1e-9
        if instant_s - HISTORY_S <= time_s <= instant_s:
            messages[types[raw.topic]].append(run.bag.deserialize(raw))
    return messages


def _antenna(messages: Mapping[str, Sequence[Any]]) -> Site:
    """Return the position of the radar or, without any replies, the middle of the tracks."""
    replies = defaultdict(list)
    for address, *reply in map(keep_reply, messages[REPLY]):
        replies[address].append(reply)
    pairs = []
    for address, flight in _flights(messages[REPORT]).items():
        if address in replies:
            stamps_s, slant_m, azimuth_deg, altitude_m = np.array(replies[address]).T
            azimuth = np.exp(1j * np.radians(azimuth_deg))
            of_radar = Replies(stamps_s, stamps_s, slant_m, azimuth, altitude_m)
            pairs.append((flight.at(stamps_s)[0], of_radar))
    if pairs:
        return find_antenna(pairs)
    newest = messages[TRACKS][-1].tracks
    middle = np.median([(track.latitude, track.longitude) for track in newest], axis=0)
    return Site(*middle.tolist())


def _flights(reports: Sequence[Any]) -> dict[str, ReportedFlight]:
    if not reports:
        return {}
    rows = np.array([keep_report(report) for report in reports], dtype=object)
    return flights(Series(rows[:, 1].astype(np.float64), rows))


def _tracks(arrays: Sequence[Any], antenna: Site) -> list[_RadarTrack]:
    """Return the tracks of the newest array, with their earlier positions."""
    positions = defaultdict(list)
    for array in arrays:
        for track in array.tracks:
            positions[track.track_id].append((track.latitude, track.longitude, track.altitude_m))
    return [
        _RadarTrack(
            _label(track),
            _seen_by(track.sources),
            _places(positions[track.track_id], antenna),
            _ahead(track),
        )
        for track in arrays[-1].tracks
    ]


def _label(track: Any) -> str:
    """Return the name and flight level of a track."""
    name = track.callsign or track.icao24 or "no name"
    level = "---" if math.isnan(track.altitude_m) else f"{track.altitude_m / FLIGHT_LEVEL_M:03.0f}"
    return f"{name} {level}"


def _seen_by(sources: int) -> str:
    if sources == _ADSB:
        return "ADS-B alone"
    return "seen by both" if sources & _ADSB else "radar alone"


def _ahead(track: Any) -> complex:
    turn = math.radians(track.track_deg)
    return cmath.rect(AHEAD_S * 1e-3 * track.ground_speed, turn)


def _places(positions: Sequence[tuple[float, ...]], antenna: Site) -> NDArray[np.complex128]:
    """Return positions [deg, deg, m] relative to the antenna; an unknown altitude counts as 0."""
    columns = np.nan_to_num(np.array(positions, dtype=np.float64).reshape(-1, 3))
    return np.asarray(antenna.seen(cartesian(*columns.T))[0] * 1e-3)


def _plot(message: Any, altitude_m: float) -> complex:
    ground_m = math.sqrt(max(message.slant_range_m**2 - altitude_m**2, 0.0))
    azimuth = math.radians(message.azimuth_deg)
    return cmath.rect(ground_m * 1e-3, azimuth)


def _xy(places: Any) -> tuple[Any, Any]:
    return np.imag(places), np.real(places)


def _draw_rings(axes: Axes, reach_km: float) -> None:
    for radius in np.arange(RING_KM, reach_km * math.sqrt(2.0), RING_KM):
        axes.add_patch(Circle((0.0, 0.0), radius, fill=False, ec=INK, alpha=0.35, lw=0.7))
    axes.plot(0.0, 0.0, "+", color=INK, ms=9)
