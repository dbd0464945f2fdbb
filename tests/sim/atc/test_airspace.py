import math

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.atc.airspace import AirSpace, Flight, Waypoint
from sim.atc.geodesy import AIRPORT, Place, destination, distance, to_geodetic
from sim.atc.traffic import FIXES

SECOND = 1_000_000_000


def flight(*route, start_s=0.0):
    return Flight("C07AB1", "ACA123", "2001", start_s, route)


def at(name, altitude_m=5_000.0, airspeed=200.0):
    return Waypoint(*FIXES[name], altitude_m, airspeed)


def flown(air, seconds, step_s=1):
    """The states of the first flight, second by second, as long as it is in the air."""
    states = []
    for second in range(0, seconds, step_s):
        air.advance_to(second * SECOND)
        if (state := air.state(0)) is not None:
            states.append(state)
    return states


def geodetic(state):
    return Place(*to_geodetic(state.x, state.y))


def test_level_flight_follows_the_geodesic_between_its_fixes_at_its_speed():
    states = flown(AirSpace([flight(at("TWEED"), at("BROCK"))], (0.0, 0.0)), 600)
    line = Geodesic.WGS84.InverseLine(*FIXES["TWEED"], *FIXES["BROCK"])
    for second, state in enumerate(states):
        expected = line.Position(200.0 * second)
        here = geodetic(state)
        assert distance(here, Place(expected["lat2"], expected["lon2"])) < 15.0
        assert state.altitude_m == 5_000.0


@given(st.floats(0.0, 30.0), st.floats(0.0, 2.0 * math.pi))
@settings(max_examples=20)
def test_wind_changes_the_speed_over_ground_and_not_the_way(speed, towards):
    wind = speed * math.sin(towards), speed * math.cos(towards)
    states = flown(AirSpace([flight(at("TWEED"), at("WATER"))], wind), 400, 20)
    line = Geodesic.WGS84.InverseLine(*FIXES["TWEED"], *FIXES["WATER"])
    for state in states:
        assert math.hypot(state.vx - wind[0], state.vy - wind[1]) == pytest.approx(200.0)
        there = line.Position(distance(FIXES["TWEED"], geodetic(state)))
        assert distance(geodetic(state), Place(there["lat2"], there["lon2"])) < 60.0


def test_a_flight_appears_at_its_time_and_is_gone_after_its_last_fix():
    length_s = distance(FIXES["PICTN"], AIRPORT) / 200.0
    air = AirSpace([flight(at("PICTN"), at("YGK"), start_s=50.0)], (0.0, 0.0))
    there = []
    for second in range(400):
        air.advance_to(second * SECOND)
        there.append(air.state(0) is not None)
        assert len(air.in_the_air()[0]) == there[-1]
    assert there.index(True) == 50
    assert sum(there) == pytest.approx(length_s, abs=2.0)


def test_an_arrival_is_at_each_fix_at_its_altitude_and_speed():
    route = at("PERTH", 4_000.0, 150.0), at("INBND", 1_500.0, 100.0), at("FINAL", 750.0, 80.0)
    states = flown(AirSpace([flight(*route, at("YGK", 93.0, 70.0))], (5.0, -8.0)), 1_200)
    for point in route[1:]:
        fix = Place(point.latitude, point.longitude)
        nearest = min(states, key=lambda state: distance(geodetic(state), fix))
        assert distance(geodetic(nearest), fix) < 1_500.0  # it flies by, not over
        assert nearest.altitude_m == pytest.approx(point.altitude_m, abs=100.0)
    assert distance(geodetic(states[-1]), AIRPORT) < 200.0
    assert states[-1].altitude_m == pytest.approx(93.0, abs=15.0)


@given(st.floats(-150.0, 150.0))
@settings(max_examples=20)
def test_turns_are_no_faster_than_standard_rate_and_reach_the_next_fix(turn_deg):
    middle = destination(AIRPORT, 0.0, 30_000.0)
    end = destination(middle, turn_deg, 30_000.0)
    route = [Waypoint(*place, 3_000.0, 120.0) for place in (AIRPORT, middle, end)]
    air = AirSpace([flight(*route)], (0.0, 0.0))
    states = flown(air, 600)
    assert air.state(0) is None
    headings = np.unwrap([math.atan2(state.vx, state.vy) for state in states])
    assert np.abs(np.diff(headings)).max() <= math.radians(3.0) + 1e-9
    assert distance(geodetic(states[-1]), end) < 300.0


@given(st.lists(st.integers(1, 5_000), min_size=1, max_size=40))
def test_flights_do_not_depend_on_the_times_of_observation(pauses_ms):
    route = at("BELLE", 3_000.0), at("YGK", 5_000.0), at("SMITH", 5_000.0)
    often, once = (AirSpace([flight(*route)], (3.0, 4.0)) for _ in range(2))
    now_ns = 0
    for pause_ms in pauses_ms:
        now_ns += pause_ms * 1_000_000
        often.advance_to(now_ns)
    once.advance_to(now_ns)
    assert often.state(0) == once.state(0)
    assert tuple(often.in_the_air()[1][0]) == pytest.approx(often.state(0), rel=1e-15)
