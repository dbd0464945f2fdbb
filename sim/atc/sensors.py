"""The sensors: an ADS-B ground receiver, and two radars on one turning antenna at the airport.

Exact states come from callables; no sensor has access to the air space itself. Figures are those of
the standards: rates and accuracy categories of ADS-B from RTCA DO-260B (position and velocity
squitters every 0.4 to 0.6 s, NACp 9: within 30 m in 95 %; NACv 2: within 3 m/s; altitude in steps
of 25 ft), random errors and detection of the radars from EUROCONTROL's standard for radar
surveillance (SUR.ET1.ST01.1000-STD-01-01: primary 120 m, 0.15 deg, 90 %; secondary 70 m, 0.08 deg,
97 %).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.arrays import Floats, Ints
from sim.atc.airspace import AircraftState
from sim.atc.geodesy import convergence, slant_range, to_geodetic
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header, time_message

CLOCK_NS = 100 * MILLISECOND
TURN_S = 4.8  # of the antenna, usual in terminal areas (12.5 rpm)
SECTORS = 16  # a radar reports once for each sector
SECTOR_DEG = 360.0 / SECTORS
SECTOR_NS = round(TURN_S * SECOND / SECTORS)
RADAR_RANGE_M = 111_120.0  # 60 NM
RADAR_FRAME = "radar"
ALTITUDE_STEP_M = 25 * 0.3048

ADSB_TYPE = "atc_msgs/msg/AdsbReport"
PLOT_TYPE = "atc_msgs/msg/RadarPlot"
REPLY_TYPE = "atc_msgs/msg/SecondaryReply"

_Clock = message_class("rosgraph_msgs/msg/Clock")
_AdsbReport = message_class(ADSB_TYPE)
_RadarPlot = message_class(PLOT_TYPE)
_SecondaryReply = message_class(REPLY_TYPE)

_CLOSEST_S, _FARTHEST_S = 0.4, 0.6  # from one squitter to the next
_RECEPTION = 0.95  # share of squitters that are decoded
_EPU_M = (10.0, 30.0)  # NACp 10 and 9: radius that holds 95 % of position errors
_EPU_IN_SD = math.sqrt(-2.0 * math.log(0.05))  # of the errors along one axis
_GNSS_CORRELATION_S = 60.0  # position errors change slowly
_SPEED_SD = 3.0 / _EPU_IN_SD  # along one axis [m/s]


@dataclass(frozen=True, slots=True)
class Transponder:
    """Identity that an aircraft transmits."""

    icao24: str
    callsign: str
    squawk: str


@dataclass(frozen=True, slots=True)
class RadarErrors:
    """Random errors of a radar."""

    range_sd_m: float
    azimuth_sd_deg: float
    detection: float  # probability of detection per turn
    range_bias_m: float = 0.0
    azimuth_bias_deg: float = 0.0


PRIMARY = RadarErrors(120.0, 0.15, 0.90)
SECONDARY = RadarErrors(70.0, 0.08, 0.97)
FALSE_PLOTS = 2.0  # of the primary radar, mean number per turn; the standard allows 20


class AirspaceClock(Node):
    """``/clock``."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/airspace")
        clock = self.create_publisher("rosgraph_msgs/msg/Clock", "/clock", qos.CLOCK)
        self.create_timer(CLOCK_NS, lambda: clock.publish(_Clock(time_message(self.now_ns))))


class AdsbReceiver(Node):
    """``/adsb``: one report for each position squitter that was decoded.

    Parameters
    ----------
    domain, rng
        As for `Node`.
    transponders
        Those of all aircraft that may appear.
    measure
        Exact state of the n-th of them now; None while it is not in the air.
    """

    def __init__(
        self,
        domain: Domain,
        transponders: Sequence[Transponder],
        measure: Callable[[int], AircraftState | None],
        rng: np.random.Generator,
    ) -> None:
        super().__init__(domain, "/adsb_receiver", rng=rng)
        self._measure = measure
        self._transponders = transponders
        self._publisher = self.create_publisher(ADSB_TYPE, "/adsb", qos.SENSOR_DATA)
        numbers = ("latitude", "longitude", "altitude_m", "ground_speed", "track_deg")
        self._templates = [
            Template(_report(0, who, 0.0, 0.0, 0.0, 0.0, 0.0), ADSB_TYPE, (*STAMP, *numbers))
            for who in transponders
        ]
        count = len(transponders)
        self._position_sd = (rng.uniform(*_EPU_M, count) / _EPU_IN_SD).tolist()
        self._errors = np.multiply(rng.standard_normal((2, count)), self._position_sd).T.tolist()
        self._last_ns = [self.now_ns] * count
        for index, phase_s in enumerate(rng.uniform(0.0, _FARTHEST_S, count).tolist()):
            self.call_later(round(phase_s * SECOND), self._squitter, index)

    def _squitter(self, index: int) -> None:
        pause, reception = self.rng.random(2).tolist()
        due_s = _CLOSEST_S + (_FARTHEST_S - _CLOSEST_S) * pause
        self.call_later(round(due_s * SECOND), self._squitter, index)
        state = self._measure(index)
        if state is not None and reception < _RECEPTION:
            self._publish(index, state)

    def _publish(self, index: int, state: AircraftState) -> None:
        noise_x, noise_y, noise_vx, noise_vy = self.rng.standard_normal(4).tolist()
        east, north = self._errors[index]
        kept = math.exp((self._last_ns[index] - self.now_ns) / SECOND / _GNSS_CORRELATION_S)
        fresh = self._position_sd[index] * math.sqrt(1.0 - kept**2)
        east, north = kept * east + fresh * noise_x, kept * north + fresh * noise_y
        self._errors[index] = [east, north]
        self._last_ns[index] = self.now_ns

        latitude, longitude = to_geodetic(state.x + east, state.y + north)
        vx, vy = state.vx + _SPEED_SD * noise_vx, state.vy + _SPEED_SD * noise_vy
        track = math.atan2(vx, vy) + convergence(latitude, longitude)
        numbers = (
            latitude,
            longitude,
            _quantized(state.altitude_m),
            math.hypot(vx, vy),
            math.degrees(track) % 360.0,
        )
        self._publisher.publish(
            _report(self.now_ns, self._transponders[index], *numbers),
            self._templates[index].data(*self.stamp, *numbers),
        )


def _report(time_ns: int, who: Transponder, *numbers: float) -> Any:
    return _AdsbReport(header(time_ns, "wgs84"), who.icao24, who.callsign, *numbers)


def _quantized(altitude_m: float) -> float:
    """Return an altitude as transponders send it, in whole steps of 25 ft [m]."""
    return round(altitude_m / ALTITUDE_STEP_M) * ALTITUDE_STEP_M


class Plot(NamedTuple):
    """An aircraft that the beam found."""

    flight: int
    time_ns: int
    slant_m: float
    azimuth_deg: float
    altitude_m: float


class _Radar(Node):
    """A turning radar that reports the detections of a sector at the sector's end.

    It detects nothing more than 45 degrees above the horizon (the cone of silence).

    Parameters
    ----------
    domain, rng
        As for `Node`.
    measure
        Returns the numbers of the flights in the air now, and their exact states, columns as in
        `AircraftState`.
    errors
        Its random errors.
    """

    NAME: ClassVar[str]
    TOPIC: ClassVar[str]
    TYPE: ClassVar[str]

    def __init__(
        self,
        domain: Domain,
        measure: Callable[[], tuple[Ints, Floats]],
        errors: RadarErrors,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(domain, self.NAME, rng=rng)
        self._measure = measure
        self._errors = errors
        self._sector = 0
        self.create_timer(SECTOR_NS, self._end_sector)
        self._publisher = self.create_publisher(self.TYPE, self.TOPIC, qos.SENSOR_DATA)

    def on_sector(self, start_deg: float, plots: Sequence[Plot]) -> None:
        """Publish the detections of the sector that has just ended."""
        raise NotImplementedError

    def beam_time_ns(self, azimuth_deg: float, start_deg: float) -> int:
        """Return when the beam pointed to an azimuth in the sector that has just ended [ns]."""
        ago = SECTOR_DEG - (azimuth_deg - start_deg)
        return self.now_ns - round(ago / 360.0 * TURN_S * SECOND)

    def _end_sector(self) -> None:
        start_deg = self._sector * SECTOR_DEG
        self._sector = (self._sector + 1) % SECTORS
        flights, states = self._measure()
        plots = []
        for row, azimuth_deg in _passed(states, start_deg):
            time_ns = self.beam_time_ns(azimuth_deg, start_deg)
            plot = self._look(int(flights[row]), AircraftState(*states[row].tolist()), time_ns)
            if plot is not None:
                plots.append(plot)
        self.on_sector(start_deg, plots)

    def _look(self, flight: int, state: AircraftState, time_ns: int) -> Plot | None:
        """Detect an aircraft, now in ``state``, where the beam passed it; None if it is missed."""
        errors = self._errors
        ago_s = (self.now_ns - time_ns) / SECOND
        x, y = state.x - ago_s * state.vx, state.y - ago_s * state.vy
        altitude_m = state.altitude_m - ago_s * state.vz
        ground_m = math.hypot(x, y)
        slant_m = slant_range(ground_m, altitude_m)
        found = self.rng.random() < errors.detection
        range_noise, azimuth_noise = self.rng.standard_normal(2).tolist()
        if not found or altitude_m > ground_m or slant_m > RADAR_RANGE_M:
            return None
        slant_m += errors.range_bias_m + errors.range_sd_m * range_noise
        azimuth = math.degrees(math.atan2(x, y))
        azimuth += errors.azimuth_bias_deg + errors.azimuth_sd_deg * azimuth_noise
        return Plot(flight, time_ns, slant_m, azimuth % 360.0, altitude_m)


@jit
def _passed(states: Floats, start_deg: float) -> list[tuple[int, float]]:
    """Return which rows are in a sector, and their azimuths [deg]."""
    rows = []
    for row in range(len(states)):
        azimuth_deg = math.degrees(math.atan2(states[row, 0], states[row, 1])) % 360.0
        if start_deg <= azimuth_deg < start_deg + SECTOR_DEG:
            rows.append((row, azimuth_deg))
    return rows


class PrimaryRadar(_Radar):
    """``/psr``: echoes of aircraft, and clutter."""

    NAME, TOPIC, TYPE = "/primary_radar", "/psr", PLOT_TYPE

    def on_sector(self, start_deg: float, plots: Sequence[Plot]) -> None:
        """Publish range and azimuth of aircraft and of clutter."""
        echoes = [(plot.time_ns, plot.slant_m, plot.azimuth_deg) for plot in plots]
        for _ in range(self.rng.poisson(FALSE_PLOTS / SECTORS)):
            slant_m = self.rng.uniform(0.0, RADAR_RANGE_M)
            azimuth_deg = start_deg + self.rng.uniform(0.0, SECTOR_DEG)
            echoes.append((self.beam_time_ns(azimuth_deg, start_deg), slant_m, azimuth_deg))
        for time_ns, slant_m, azimuth_deg in echoes:
            self._publisher.publish(_RadarPlot(header(time_ns, RADAR_FRAME), slant_m, azimuth_deg))


class SecondaryRadar(_Radar):
    """``/ssr``: the replies of transponders.

    ``transponders`` are those of all aircraft that may appear.
    """

    NAME, TOPIC, TYPE = "/secondary_radar", "/ssr", REPLY_TYPE

    def __init__(
        self,
        domain: Domain,
        transponders: Sequence[Transponder],
        measure: Callable[[], tuple[Ints, Floats]],
        errors: RadarErrors,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(domain, measure, errors, rng)
        self._transponders = transponders

    def on_sector(self, start_deg: float, plots: Sequence[Plot]) -> None:  # noqa: ARG002
        """Publish range, azimuth, identity and altitude."""
        for plot in plots:
            who = self._transponders[plot.flight]
            self._publisher.publish(
                _SecondaryReply(
                    header(plot.time_ns, RADAR_FRAME), plot.slant_m, plot.azimuth_deg, who.icao24,
                    who.squawk, _quantized(plot.altitude_m),
                )
            )  # fmt: skip
