"""The picture of an air traffic recording: its tracks, as a display shows them from above."""

import cmath
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import NDArray

from oracle_pipeline.features.geometry.wgs84 import Site, cartesian
from oracle_pipeline.opened_run import OpenedRun
from oracle_pipeline.reporting.figures import AMBER, COLORS, INK, drawing
from oracle_pipeline.reporting.stored_report import ReportError

TRACKS = "atc_msgs/msg/TrackArray"
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
    """One track of the fusion; positions are north + i east of the middle of all tracks [km]."""

    label: str
    seen_by: str  # a key of the legend
    trail: NDArray[np.complex128]  # (n,), the newest last
    ahead: complex  # predicted displacement in a minute


@dataclass(frozen=True, eq=False, slots=True)
class _Display:
    """The display at one instant."""

    title: str
    tracks: list[_RadarTrack]


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
    arrays = _track_arrays(run, instant_s)
    if not arrays or not arrays[-1].tracks:
        raise ReportError(f"{run.path} cannot be drawn: there is no track a quarter through it.")
    name = run.path.resolve().name if run.manifest is None else run.manifest.key
    return _Display(f"{name}, {instant_s:.0f} s", _tracks(arrays))


def plan_view(display: _Display) -> bytes:
    """Draw the display as PNG, in the style of ``reporting.figures``; north is up."""
    trails = np.concatenate([track.trail for track in display.tracks])
    reach = RING_KM * math.ceil(float(np.abs(trails).max()) / RING_KM)
    with drawing(4.7, 5.2) as (axes, png):
        _draw_rings(axes, reach)
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
        axes.set(xlabel="east [km]", ylabel="north [km]", title=display.title)
        axes.figure.legend(loc="outside lower center", ncols=3, fontsize="small", markerscale=1.2)
    return png.getvalue()


def _track_arrays(run: OpenedRun, instant_s: float) -> list[Any]:
    """Return the messages of tracks in the history."""
    wanted = {name for name, topic in run.bag.topics.items() if topic.msgtype == TRACKS}
    return [
        run.bag.deserialize(raw)
        for raw in run.bag.messages(wanted)
        if instant_s - HISTORY_S <= (raw.stamp_ns - run.bag.start_ns) * 1e-9 <= instant_s
    ]


def _tracks(arrays: Sequence[Any]) -> list[_RadarTrack]:
    """Return the tracks of the newest array, with their earlier positions."""
    newest = arrays[-1].tracks
    middle = np.median([(track.latitude, track.longitude) for track in newest], axis=0)
    site = Site(*middle.tolist())
    positions = defaultdict(list)
    for array in arrays:
        for track in array.tracks:
            positions[track.track_id].append((track.latitude, track.longitude, track.altitude_m))
    return [
        _RadarTrack(
            _label(track), _seen_by(track.sources), _places(positions[track.track_id], site),
            cmath.rect(AHEAD_S * 1e-3 * track.ground_speed, math.radians(track.track_deg)),
        )
        for track in newest
    ]  # fmt: skip


def _label(track: Any) -> str:
    """Return the name and flight level of a track."""
    name = track.callsign or track.icao24 or "no name"
    level = "---" if math.isnan(track.altitude_m) else f"{track.altitude_m / FLIGHT_LEVEL_M:03.0f}"
    return f"{name} {level}"


def _seen_by(sources: int) -> str:
    if sources == _ADSB:
        return "ADS-B alone"
    return "seen by both" if sources & _ADSB else "radar alone"


def _places(positions: Sequence[tuple[float, ...]], site: Site) -> NDArray[np.complex128]:
    """Return positions [deg, deg, m] relative to a site [km]; an unknown altitude counts as 0."""
    columns = np.nan_to_num(np.array(positions, dtype=np.float64).reshape(-1, 3))
    return np.asarray(site.seen(cartesian(*columns.T))[0] * 1e-3)


def _xy(places: Any) -> tuple[Any, Any]:
    return np.imag(places), np.real(places)


def _draw_rings(axes: Axes, reach_km: float) -> None:
    for radius in np.arange(RING_KM, reach_km * math.sqrt(2.0), RING_KM):
        axes.add_patch(Circle((0.0, 0.0), radius, fill=False, ec=INK, alpha=0.35, lw=0.7))
