"""The fusion node: one track for each aircraft, from ADS-B and both radars.

A report with an address belongs to the track of that address. A primary echo belongs to the nearest
track that it fits. A measurement that does not fit its track is ignored. After three such
measurements in a row, the track moves there. So ADS-B, which reports most often, decides where a
track is. Values that no sensor can measure are ignored.
"""

import math
from collections.abc import Callable
from typing import Any, Generic, TypeAlias

from oracle_pipeline.bags.types import message_class
from sim.atc import sensors
from sim.atc.filter import MotionFilter, Position
from sim.atc.geodesy import convergence, ground_range, to_geodetic, to_plane
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header, stamp_ns

ADSB_TOPIC = "/adsb_fuzzed"  # where the mode's node publishes the receiver's reports
TRACKS_TYPE = "atc_msgs/msg/TrackArray"
TRACKS_NS = 1 * SECOND

_Track = message_class("atc_msgs/msg/Track")
_TrackArray = message_class(TRACKS_TYPE)

ADSB, PSR, SSR = 1, 2, 4  # as in atc_msgs/msg/Track

GATE = 25.0  # variances; one of 300,000 correct reports is outside
STRIKES = 3  # reports in a row that do not fit, after which the track moves
CONFIRMED_AFTER = 3  # reports
MEMORY_NS = round(2 * sensors.TURN_S * SECOND)  # how long a source counts after its last report
LIFETIME_NS = round(3 * sensors.TURN_S * SECOND)  # of a track without new reports
TENTATIVE_LIFETIME_NS = round(1.5 * sensors.TURN_S * SECOND)

# What the fields of a squitter can hold.
_LOWEST_M, _HIGHEST_M = -1_000 * 0.3048, 126_700 * 0.3048
_FASTEST = 4_100 * 0.5144  # [m/s]

_ADSB_SD_M = 30.0 / 2.45  # NACp 9, along one axis
_ADSB_SPEED_SD = 3.0 / 2.45  # NACv 2 [m/s]
_ALTITUDE_SD_M = sensors.ALTITUDE_STEP_M / math.sqrt(12.0)
_ANY_SPEED = 150.0  # standard deviation where nothing is known [m/s]
_ANY_CLIMB = 10.0
_USUAL_ALTITUDE_M = 3_000.0  # for echoes of which nothing else is known
_TURNING = 25.0  # spectral density of acceleration [m^2/s^3]
_CLIMBING = 0.5

_Start: TypeAlias = Callable[[int, Position, float], MotionFilter[Position]]  # time [ns], sd


class _Estimate(Generic[Position]):
    """A filter that restarts when measurements no longer fit it."""

    def __init__(self, start: _Start[Position]) -> None:
        self._start: _Start[Position] = start
        self.motion: MotionFilter[Position] | None = None
        self._strikes = 0

    def distance_squared(self, time_ns: int, position: Position, sd: float) -> float:
        """Return how far a measured position is from the expected one, in variances."""
        if self.motion is None:
            return math.inf
        return self.motion.distance_squared(time_ns, position, sd)

    def take(self, time_ns: int, position: Position, sd: float) -> bool:
        """Update with a measured position; return whether it was used."""
        motion = self.motion
        if motion is not None and motion.distance_squared(time_ns, position, sd) <= GATE:
            motion.update(time_ns, position, sd)
        else:
            self._strikes += 1
            if motion is not None and self._strikes < STRIKES:
                return False
            self.motion = self._start(time_ns, position, sd)
        self._strikes = 0
        return True


class _Aircraft:
    """A track with its filters and the state of its sources."""

    def __init__(self, track_id: int) -> None:
        self.track_id = track_id
        self.icao24 = ""
        self.callsign = ""
        self.squawk = ""
        self.reports = 0
        self.received_ns: dict[int, int] = {}  # by source
        self.place = _Estimate[complex](
            lambda time_ns, place, sd: MotionFilter(time_ns, place, 0j, sd, _ANY_SPEED, _TURNING)
        )
        self.height = _Estimate[float](
            lambda time_ns, up, sd: MotionFilter(time_ns, up, 0.0, sd, _ANY_CLIMB, _CLIMBING)
        )

    @property
    def is_confirmed(self) -> bool:
        return self.reports >= CONFIRMED_AFTER

    def altitude_m(self, time_ns: int) -> float:
        """Return the altitude at a time [m]; NaN if no source has reported one."""
        return math.nan if self.height.motion is None else self.height.motion.at(time_ns)

    def take(self, source: int, time_ns: int, place: complex, sd: float) -> bool:
        """Update with a measured position; return whether it was used."""
        counted = self.place.take(time_ns, place, sd)
        if counted:
            self.reports += 1
            self.received_ns[source] = time_ns
        return counted

    def moves(self, velocity: complex, sd: float) -> None:
        """Update with the velocity that came with the last position."""
        if self.place.motion is not None:
            self.place.motion.update_velocity(velocity, sd)

    def is_alive(self, now_ns: int) -> bool:
        lifetime_ns = LIFETIME_NS if self.is_confirmed else TENTATIVE_LIFETIME_NS
        return now_ns - max(self.received_ns.values()) <= lifetime_ns

    def message(self, now_ns: int) -> Any:
        motion, height = self.place.motion, self.height.motion
        assert motion is not None  # noqa: S101 -- a track begins with a position
        place, velocity = motion.at(now_ns), motion.velocity
        latitude, longitude = to_geodetic(place.real, place.imag)
        track = math.atan2(velocity.real, velocity.imag) + convergence(latitude, longitude)
        recent = (s for s, time_ns in self.received_ns.items() if now_ns - time_ns <= MEMORY_NS)
        return _Track(
            self.track_id, self.icao24, self.callsign, self.squawk, latitude, longitude,
            self.altitude_m(now_ns), abs(velocity), math.degrees(track) % 360.0,
            0.0 if height is None else height.velocity, sum(recent),
        )  # fmt: skip


class Fusion(Node):
    """``/adsb_fuzzed``, ``/psr`` and ``/ssr`` in, ``/tracks`` out once a second."""

    def __init__(self, domain: Domain, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/fusion", latency_ns=latency_ns)
        self._tracks: list[_Aircraft] = []
        self._by_address: dict[str, _Aircraft] = {}
        self._begun = 0
        self._publisher = self.create_publisher(TRACKS_TYPE, "/tracks")
        self.create_subscription(sensors.ADSB_TYPE, ADSB_TOPIC, self._on_adsb, qos.SENSOR_DATA)
        self.create_subscription(sensors.PLOT_TYPE, "/psr", self._on_echo, qos.SENSOR_DATA)
        self.create_subscription(sensors.REPLY_TYPE, "/ssr", self._on_reply, qos.SENSOR_DATA)
        self.create_timer(TRACKS_NS, self._publish)

    def _on_adsb(self, report: Any) -> None:
        if not (
            abs(report.latitude) <= 90.0
            and abs(report.longitude) <= 180.0
            and _is_altitude(report.altitude_m)
            and 0.0 <= report.ground_speed <= _FASTEST
            and 0.0 <= report.track_deg <= 360.0
        ):
            return
        time_ns = self._time_ns(report)
        place = complex(*to_plane(report.latitude, report.longitude))
        track = self._addressed(report.icao24, time_ns, place, _ADSB_SD_M)
        if track.take(ADSB, time_ns, place, _ADSB_SD_M):
            bearing = math.radians(report.track_deg)
            bearing -= convergence(report.latitude, report.longitude)
            velocity = report.ground_speed * complex(math.sin(bearing), math.cos(bearing))
            track.moves(velocity, _ADSB_SPEED_SD)
        track.height.take(time_ns, report.altitude_m, _ALTITUDE_SD_M)
        track.callsign = report.callsign

    def _on_reply(self, reply: Any) -> None:
        if not (_is_plot(reply) and _is_altitude(reply.altitude_m)):
            return
        time_ns = self._time_ns(reply)
        place, sd = _located(reply, reply.altitude_m, sensors.SECONDARY)
        track = self._addressed(reply.icao24, time_ns, place, sd)
        track.take(SSR, time_ns, place, sd)
        track.height.take(time_ns, reply.altitude_m, _ALTITUDE_SD_M)
        track.squawk = reply.squawk

    def _on_echo(self, plot: Any) -> None:
        if not _is_plot(plot):
            return
        time_ns = self._time_ns(plot)
        best: tuple[bool, float] | None = None  # a confirmed track takes precedence
        track, altitude_m = None, math.nan
        for candidate in self._tracks:
            height_m = candidate.altitude_m(time_ns)
            place, sd = _located(plot, height_m, sensors.PRIMARY)
            apart = candidate.place.distance_squared(time_ns, place, sd)
            rank = not candidate.is_confirmed, apart
            if apart <= GATE and (best is None or rank < best):
                best, track, altitude_m = rank, candidate, height_m
        place, sd = _located(plot, altitude_m, sensors.PRIMARY)
        (track or self._begin()).take(PSR, time_ns, place, sd)

    def _addressed(self, icao24: str, time_ns: int, place: complex, sd: float) -> _Aircraft:
        """Return the track of an address: its own, a fitting one without address, or a new one."""
        track = self._by_address.get(icao24)
        if track is None:
            nameless = (t for t in self._tracks if not t.icao24)
            fitting = (t for t in nameless if t.place.distance_squared(time_ns, place, sd) <= GATE)
            track = next(fitting, None) or self._begin()
            track.icao24 = icao24
            self._by_address[icao24] = track
        return track

    def _begin(self) -> _Aircraft:
        self._begun += 1
        track = _Aircraft(self._begun)
        self._tracks.append(track)
        return track

    def _publish(self) -> None:
        self._tracks = [track for track in self._tracks if track.is_alive(self.now_ns)]
        self._by_address = {track.icao24: track for track in self._tracks if track.icao24}
        confirmed = [t.message(self.now_ns) for t in self._tracks if t.is_confirmed]
        self._publisher.publish(_TrackArray(header(self.now_ns, "wgs84"), confirmed))

    def _time_ns(self, report: Any) -> int:
        """Return when a report was measured, at the latest now [ns]."""
        return min(stamp_ns(report.header.stamp), self.now_ns)


def _is_altitude(altitude_m: float) -> bool:
    return _LOWEST_M <= altitude_m <= _HIGHEST_M


def _is_plot(plot: Any) -> bool:
    in_range = 0.0 <= plot.slant_range_m <= 2.0 * sensors.RADAR_RANGE_M
    return bool(in_range and 0.0 <= plot.azimuth_deg <= 360.0)


def _located(plot: Any, altitude_m: float, errors: sensors.RadarErrors) -> tuple[complex, float]:
    """Return the position of a plot in the plane, and its larger standard deviation [m]."""
    if math.isnan(altitude_m):
        altitude_m = _USUAL_ALTITUDE_M
    ground_m = ground_range(plot.slant_range_m, altitude_m)
    azimuth = math.radians(plot.azimuth_deg)
    across_m = ground_m * math.radians(errors.azimuth_sd_deg)
    place = ground_m * complex(math.sin(azimuth), math.cos(azimuth))
    return place, max(errors.range_sd_m, across_m)
