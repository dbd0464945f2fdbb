"""Features of the tracks and warnings of the air traffic fusion.

A track that only one kind of sensor supports is an aircraft that hides or does not exist; two
tracks that move together are one aircraft detected at two positions.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.geometry.scans import Bools, Floats
from oracle_pipeline.features.geometry.wgs84 import Site, cartesian
from oracle_pipeline.features.statistics.reduction import largest, mean, quantile

_TRACK_FEATURES = (
    fp.Feature("adsb_only", "1", 0.01, "share of the tracks without radar, mean", "domain"),
    fp.Feature("radar_only", "1", 0.01, "share of the tracks without ADS-B, mean", "domain"),
    fp.Feature("nameless", "1", 0.01, "share of the tracks without ICAO address, mean", "domain"),
    fp.Feature("longest_adsb_only", "s", 5.0, "longest time that a track had ADS-B but no radar",
        "domain", per_window=False, extensive=True),
    fp.Feature("longest_radar_only", "s", 5.0, "longest time that a track had no ADS-B",
        "domain", per_window=False, extensive=True),
    fp.Feature(
        "closest_pair", "m", 50.0, "distance of the two closest tracks, 5th percentile", "domain",
        behaviour=True,
    ),
    fp.Feature("closest_pair_speed", "m/s", 2.0,
        "relative speed of the two closest tracks, median", "domain",
        behaviour=True),
)  # fmt: skip
_ADVISORY_FEATURES = (
    fp.Feature(
        "traffic_advisories", "1/min", 0.5, "traffic advisories to aircraft per minute", "domain",
        behaviour=True,
    ),
    fp.Feature(
        "resolution_advisories", "1/min", 0.5, "resolution advisories to aircraft per minute",
        "domain", behaviour=True,
    ),
)  # fmt: skip

# As in the definitions of Track and Advisory.
_ADSB = 1
_TRAFFIC, _RESOLUTION = 1, 2

_SHARES = ("adsb_only", "radar_only", "nameless")


@dataclass(frozen=True, slots=True)
class _Picture:
    """Statistics of the messages of one topic, by time."""

    shares: dict[str, fp.Series]  # of the tracks of each message
    longest_s: dict[str, float]
    distance_m: fp.Series  # of the closest pair
    speed: fp.Series  # of that pair relative to each other [m/s]


def _keep_tracks(message: Any) -> Floats:
    """Return the tracks of a ``TrackArray`` as rows.

    Columns are identifier, 1 if it has an address, sources, latitude and longitude [deg],
    altitude [m], ground speed [m/s] and track [deg].
    """
    rows = [
        (
            t.track_id, bool(t.icao24), t.sources, t.latitude, t.longitude, t.altitude_m,
            t.ground_speed, t.track_deg,
        )
        for t in message.tracks
    ]  # fmt: skip
    return np.array(rows, dtype=np.float64).reshape(-1, 8)


def _prepare_tracks(window: fp.Window) -> dict[str, _Picture]:
    """Return statistics of the messages of each topic."""
    return {topic: _picture(series) for topic, series in window.topics["tracks"].items()}


def _compute_tracks(window: fp.Window) -> fp.Values:
    """Reduce to the window."""
    pictures: dict[str, _Picture] = window.prepared
    none, single = "no track in this window", "fewer than two tracks in this window"
    values: dict[str, Any] = {}
    for name in _SHARES:
        shares = {topic: mean(picture.shares[name], window) for topic, picture in pictures.items()}
        values[name] = largest(shares, none)
    for name in ("adsb_only", "radar_only"):
        longest = {topic: picture.longest_s[name] for topic, picture in pictures.items()}
        values[f"longest_{name}"] = largest(longest, none)
    distance = min(quantile(p.distance_m, window, 0.05) for p in pictures.values())
    speed = min(quantile(p.speed, window, 0.5) for p in pictures.values())
    return values | {
        "closest_pair": fp.Missing(single) if math.isnan(distance) else distance,
        "closest_pair_speed": fp.Missing(single) if math.isnan(speed) else speed,
    }


def closest(tracks: Floats) -> tuple[float, float]:
    """Return the distance [m] and relative speed [m/s] of the two closest tracks, or NaN.

    A track without an altitude is assumed to be at the same height as every other.
    """
    if len(tracks) < 2:
        return math.nan, math.nan
    latitude, longitude, altitude_m, speed, course_deg = tracks.T[3:]
    place, _ = Site(latitude[0], longitude[0]).seen(cartesian(latitude, longitude, 0.0))
    velocity = speed * np.exp(1j * np.radians(course_deg))
    one, other = np.triu_indices(len(tracks), 1)
    higher_m = np.nan_to_num(altitude_m[one] - altitude_m[other])
    distance_m = np.hypot(np.abs(place[one] - place[other]), higher_m)
    pair = int(np.argmin(distance_m))
    return float(distance_m[pair]), float(abs(velocity[one[pair]] - velocity[other[pair]]))


def longest_s(times_s: Floats, identifiers: Sequence[Floats], flags: Sequence[Bools]) -> float:
    """Return the longest time for which a track was flagged in consecutive messages [s].

    Parameters
    ----------
    times_s
        Of the messages.
    identifiers, flags
        Of the tracks of each message.
    """
    since: dict[float, float] = {}
    longest = 0.0
    for time_s, tracks, flagged in zip(times_s.tolist(), identifiers, flags, strict=True):
        since = {track: since.get(track, time_s) for track in tracks[flagged].tolist()}
        longest = max(longest, time_s - min(since.values(), default=time_s))
    return longest


def _keep_advisory(message: Any) -> tuple[float, float]:
    """Return whether an ``Advisory`` is a traffic advisory, and whether a resolution advisory."""
    return float(message.level == _TRAFFIC), float(message.level == _RESOLUTION)


def _compute_advisories(window: fp.Window) -> fp.Values | fp.Missing:
    """Count over the window; a silent topic counts as none."""
    if not window.history["advisories"]:
        return fp.Missing("no advisory topic is recorded")
    counts = np.zeros(2)
    for series in window.topics["advisories"].values():
        counts += series.values.sum(axis=0)
    traffic, resolution = (counts * 60.0 / (window.end_s - window.start_s)).tolist()
    return {"traffic_advisories": traffic, "resolution_advisories": resolution}


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of tracks and advisories."""
    tracks = {"tracks": fp.Request(_keep_tracks, msgtype="atc_msgs/msg/TrackArray", dtype=object)}
    advisories = {
        "advisories": fp.Request(_keep_advisory, msgtype="atc_msgs/msg/Advisory", optional=True)
    }
    return [
        fp.FeaturePlugin(
            "atc_tracks", "atc", _TRACK_FEATURES, _compute_tracks, tracks, prepare=_prepare_tracks
        ),
        fp.FeaturePlugin(
            "atc_advisories", "atc", _ADVISORY_FEATURES, _compute_advisories, advisories
        ),
    ]  # fmt: skip


def _picture(series: fp.Series) -> _Picture:
    messages = list(series.values)
    identifiers = [tracks[:, 0] for tracks in messages]
    sources = [tracks[:, 2].astype(np.int64) for tracks in messages]
    flags = {
        "adsb_only": [source == _ADSB for source in sources],
        "radar_only": [source & _ADSB == 0 for source in sources],
        "nameless": [tracks[:, 1] == 0.0 for tracks in messages],
    }
    distance_m, speed = np.array([closest(tracks) for tracks in messages]).T
    return _Picture(
        {name: fp.Series(series.times_s, _means(flags[name])) for name in _SHARES},
        {name: longest_s(series.times_s, identifiers, flags[name]) for name in flags},
        fp.Series(series.times_s, distance_m),
        fp.Series(series.times_s, speed),
    )


def _means(flags: Sequence[Bools]) -> Floats:
    """Return the share of each message's tracks that are flagged; NaN without tracks."""
    return np.array([flag.mean() if flag.size else np.nan for flag in flags])
