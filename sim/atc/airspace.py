"""The physics of air traffic: aircraft that fly their routes through the wind.

An aircraft is a point with a speed through the air, a heading and a vertical speed, which all
change at limited rates. It turns before a fix (fly-by), crabs into the wind and changes altitude
and speed along the leg. Only the simulated sensors read it; no other node does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats, Ints
from sim.atc.geodesy import Place, to_plane
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.geometry import wrapped

STEP_NS = 250 * MILLISECOND

_BANK_ACCELERATION = 9.81 * math.tan(math.radians(25.0))  # across the flight path [m/s^2]
_STANDARD_RATE = math.radians(3.0)  # the fastest turn [rad/s]
_ACCELERATION = 0.5  # along the flight path [m/s^2]
_VERTICAL_ACCELERATION = 1.0  # [m/s^2]
_VERTICAL_SPEED = 12.0  # largest vertical speed, up or down [m/s]
_LONGEST_LEAD_M = 5_000.0  # earliest start of a turn before a fix

# Columns of the state.
_X, _Y, _Z, _VX, _VY, _VZ, _AIRSPEED, _HEADING = range(8)


Wind = tuple[float, float]  # velocity of the air, east and north [m/s]


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A point of a route, with the altitude and speed that the flight should have there."""

    latitude: float  # [deg]
    longitude: float  # [deg]
    altitude_m: float  # above the ellipsoid
    airspeed: float  # [m/s]


@dataclass(frozen=True, slots=True)
class Flight:
    """One aircraft and its route: it appears at the first waypoint, and disappears at the last."""

    icao24: str
    callsign: str
    squawk: str
    start_s: float
    route: tuple[Waypoint, ...]


class AircraftState(NamedTuple):
    """Position and velocity over ground of an aircraft, in the airport's plane [m, m/s]."""

    x: float
    y: float
    altitude_m: float
    vx: float
    vy: float
    vz: float


class AirSpace:
    """All flights, from time 0 on.

    Parameters
    ----------
    flights
        The flights.
    wind
        Velocity of the air, east and north [m/s].
    """

    def __init__(self, flights: Sequence[Flight], wind: Wind) -> None:
        self._wind = wind
        self._last = np.array([len(flight.route) - 1 for flight in flights])
        self._routes = np.zeros((len(flights), max(self._last, default=0) + 1, 4))
        for route, flight in zip(self._routes, flights, strict=True):
            for row, point in zip(route, flight.route, strict=False):
                place = Place(point.latitude, point.longitude)
                row[:] = *to_plane(*place), point.altitude_m, point.airspeed
        self._start_s = np.array([flight.start_s for flight in flights])
        self._leg = np.zeros(len(flights), np.int64)  # 0: not yet in the air; > last: has left
        self._states = np.zeros((len(flights), 8))
        self._stepped_ns = -STEP_NS
        self._now_ns = 0
        self.advance_to(0)

    def advance_to(self, time_ns: int) -> None:
        """Advance all flights to a time [ns]."""
        self._now_ns = time_ns
        while self._stepped_ns + STEP_NS <= time_ns:
            self._stepped_ns += STEP_NS
            _step(
                self._states, self._leg, self._routes, self._last, self._start_s,
                self._stepped_ns / SECOND, self._wind,
            )  # fmt: skip

    def state(self, flight: int) -> AircraftState | None:
        """Return the state of the n-th flight now; None while it is not in the air."""
        if not 0 < self._leg[flight] <= self._last[flight]:
            return None
        x, y, z, vx, vy, vz = self._states[flight, :_AIRSPEED].tolist()
        ahead_s = (self._now_ns - self._stepped_ns) / SECOND
        return AircraftState(x + ahead_s * vx, y + ahead_s * vy, z + ahead_s * vz, vx, vy, vz)

    def in_the_air(self) -> tuple[Ints, Floats]:
        """Return the flights that are in the air now, and their states.

        Returns
        -------
        flights : ndarray of shape (n,)
        states : ndarray of shape (n, 6)
            Columns as in `AircraftState`.
        """
        ahead_s = (self._now_ns - self._stepped_ns) / SECOND
        return _in_the_air(self._states, self._leg, self._last, ahead_s)


@jit
def _step(
    states: Floats, leg: Ints, routes: Floats, last: Ints, start_s: Floats, now_s: float, wind: Wind
) -> None:
    """Advance every flight by one step, to ``now_s``."""
    dt, (wind_x, wind_y) = STEP_NS / SECOND, wind
    for i in range(len(states)):
        state = states[i]
        if leg[i] == 0:
            if now_s >= start_s[i]:
                _appear(state, routes[i], wind_x, wind_y)
                leg[i] = 1
            continue
        if leg[i] > last[i]:
            continue
        fix = routes[i, leg[i]]
        dx, dy = fix[0] - state[_X], fix[1] - state[_Y]
        course, to_go = math.atan2(dx, dy), math.hypot(dx, dy)
        ground_speed = math.hypot(state[_VX], state[_VY])
        turn = min(_BANK_ACCELERATION / state[_AIRSPEED], _STANDARD_RATE)
        change = 0.0
        if leg[i] < last[i]:
            after = routes[i, leg[i] + 1]
            change = abs(wrapped(math.atan2(after[0] - fix[0], after[1] - fix[1]) - course))
        lead = ground_speed / turn * math.tan(min(change, 0.9 * math.pi) / 2.0)
        abeam = dx * state[_VX] + dy * state[_VY] <= 0.0 and to_go < 2.0 * ground_speed / turn
        if abeam or to_go <= min(lead, _LONGEST_LEAD_M) + ground_speed * dt:
            leg[i] += 1

        state[_AIRSPEED] += _limited(fix[3] - state[_AIRSPEED], _ACCELERATION * dt)
        heading = course + _crab(course, state[_AIRSPEED], wind_x, wind_y)
        state[_HEADING] += _limited(wrapped(heading - state[_HEADING]), turn * dt)
        climb = (fix[2] - state[_Z]) * ground_speed / max(to_go, ground_speed)
        climb = _limited(climb, _VERTICAL_SPEED)
        state[_VZ] += _limited(climb - state[_VZ], _VERTICAL_ACCELERATION * dt)
        state[_X] += state[_VX] * dt
        state[_Y] += state[_VY] * dt
        state[_Z] += state[_VZ] * dt
        state[_VX] = state[_AIRSPEED] * math.sin(state[_HEADING]) + wind_x
        state[_VY] = state[_AIRSPEED] * math.cos(state[_HEADING]) + wind_y


@jit
def _in_the_air(states: Floats, leg: Ints, last: Ints, ahead_s: float) -> tuple[Ints, Floats]:
    """Return the flights in the air, and their states extrapolated from the last step."""
    flights = np.flatnonzero((leg > 0) & (leg <= last))
    there = states[flights, :_AIRSPEED]
    there[:, :3] += ahead_s * there[:, 3:]
    return flights, there


@jit
def _appear(state: Floats, route: Floats, wind_x: float, wind_y: float) -> None:
    """Put a flight at the start of its route, level and on course."""
    state[_X], state[_Y], state[_Z], state[_AIRSPEED] = route[0]
    course = math.atan2(route[1, 0] - route[0, 0], route[1, 1] - route[0, 1])
    state[_HEADING] = course + _crab(course, state[_AIRSPEED], wind_x, wind_y)
    state[_VX] = state[_AIRSPEED] * math.sin(state[_HEADING]) + wind_x
    state[_VY] = state[_AIRSPEED] * math.cos(state[_HEADING]) + wind_y


@jit
def _crab(course: float, airspeed: float, wind_x: float, wind_y: float) -> float:
    """Return the angle from course to heading that compensates the wind [rad]."""
    from_left = wind_x * math.cos(course) - wind_y * math.sin(course)
    return -math.asin(from_left / airspeed)


@jit
def _limited(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
