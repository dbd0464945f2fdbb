"""Air traffic: fixes and routes around Kingston, and the flights of a block.

Fixes have the names of towns. Besides drawn arrivals, departures and overflights, every block has
the same scene on the airway from Belleville to Brockville: a jet (``C07AB1``, ``ACA123``)
overtakes three slower aircraft far below it. A flight is only added if its plan stays clear of all
others.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats
from sim.atc.airspace import AirSpace, Flight, Waypoint
from sim.atc.geodesy import AIRPORT, ELEVATION_M, Place, between, destination, distance
from sim.atc.tcas import is_threat
from sim.middleware.executor import SECOND

FIXES = {
    "YGK": AIRPORT,
    "BELLE": Place(44.1628, -77.3832),  # Belleville
    "TWEED": Place(44.4760, -77.3110),
    "PERTH": Place(44.9000, -76.2490),
    "SMITH": Place(44.9050, -76.0220),  # Smiths Falls
    "BROCK": Place(44.5895, -75.6843),  # Brockville
    "WATER": Place(43.9748, -75.9108),  # Watertown
    "OSWEG": Place(43.4553, -76.5105),  # Oswego
    "PICTN": Place(44.0080, -77.1390),  # Picton
}
_FINAL_COURSE_DEG = 179.0  # of runway 19, true
FIXES["FINAL"] = destination(AIRPORT, _FINAL_COURSE_DEG + 180.0, 12_000.0)
FIXES["INBND"] = destination(AIRPORT, _FINAL_COURSE_DEG + 180.0, 24_000.0)
FIXES["OUTBD"] = destination(AIRPORT, _FINAL_COURSE_DEG, 8_000.0)

AIRWAYS = (
    ("BELLE", "YGK", "BROCK"),
    ("TWEED", "YGK", "WATER"),
    ("PERTH", "YGK", "OSWEG"),
    ("SMITH", "YGK", "PICTN"),
)
ARRIVALS_FROM = ("TWEED", "PERTH", "SMITH", "BROCK")
DEPARTURES_TO = ("OSWEG", "PICTN", "WATER", "BELLE")

FIRST_ICAO24, FIRST_CALLSIGN = "C07AB1", "ACA123"
_AIRLINES = ("ACA", "DAL", "JBU", "JZA", "POE", "SKW", "UAL", "WJA")
_LEVEL_M = 304.8  # from one flight level in use to the next, 1000 ft
_OVERTAKEN_S = (130.0, 250.0, 370.0)  # when the jet is above the slower aircraft
_DEEPER_M = 600.0  # vertical distance from each of these to the next

# Separation that flow control ensures: 3 NM or (nearly) 1000 ft, now and for the next minute.
_PLAN_TAU_S, _PLAN_DISTANCE_M, _PLAN_HEIGHT_M = 60.0, 5_556.0, 290.0
_PLAN_STEP_S = 2
_DRAWS = 400


def draw_traffic(
    rng: np.random.Generator, flights: int, duration_s: float, wind: tuple[float, float]
) -> tuple[Flight, ...]:
    """Draw the flights of a block.

    Parameters
    ----------
    rng
        The block's randomness.
    flights
        Number of flights; at least the four of the scene on the airway.
    duration_s
        Time for which they are separated [s].
    wind
        Velocity of the air, east and north [m/s].

    Raises
    ------
    OracleError
        If there is no room for so many.
    """
    cleared: list[Flight] = []
    plans: list[Floats] = []
    names = _identities(rng)
    for number in range(flights):
        icao24, callsign, squawk = next(names)
        for _ in range(_DRAWS):
            if number < 1 + len(_OVERTAKEN_S):
                start_s, route = 0.0, _on_the_airway(rng, number, cleared)
            else:
                start_s, route = _draw_route(rng, duration_s)
            flight = Flight(icao24, callsign, squawk, start_s, route)
            plan = _plan(flight, duration_s, wind)
            if not any(_meet(plan, other) for other in plans):
                break
        else:
            raise OracleError(
                f"There is no room for flight {number + 1} of {flights} within {duration_s:g} s; "
                "ask for fewer flights."
            )
        cleared.append(flight)
        plans.append(plan)
    return tuple(cleared)


def _identities(rng: np.random.Generator) -> Iterator[tuple[str, str, str]]:
    """Yield unique addresses, callsigns and squawks, one aircraft after another."""
    address, number, code = int(FIRST_ICAO24, 16), 100, 0o2001
    yield FIRST_ICAO24, FIRST_CALLSIGN, f"{code:04o}"
    while True:
        address += int(rng.integers(1, 500))
        number += int(rng.integers(30, 90))
        code += int(rng.integers(1, 30))
        yield f"{address:06X}", f"{rng.choice(_AIRLINES)}{number}", f"{code:04o}"


def _on_the_airway(
    rng: np.random.Generator, number: int, cleared: Sequence[Flight]
) -> tuple[Waypoint, ...]:
    """Return the route of the jet (number 0), or of one that it overtakes."""
    fixes = [FIXES[name] for name in AIRWAYS[0]]
    if number == 0:
        return _level(fixes, 18 * _LEVEL_M, rng.uniform(190.0, 210.0))
    jet = cleared[0].route[0]
    airspeed = rng.uniform(120.0, 140.0)
    overtaken_s = _OVERTAKEN_S[number - 1] + rng.uniform(-15.0, 15.0)
    ahead_m = (jet.airspeed - airspeed) * overtaken_s
    start = between(fixes[0], fixes[1], ahead_m / distance(fixes[0], fixes[1]))
    return _level([start, *fixes[1:]], jet.altitude_m - number * _DEEPER_M, airspeed)


def _draw_route(rng: np.random.Generator, duration_s: float) -> tuple[float, tuple[Waypoint, ...]]:
    """Draw an arrival, a departure or an overflight, and when it appears [s].

    Arrivals and overflights may already be under way at the beginning.
    """
    kind = rng.choice(("arrival", "departure", "overflight"))
    start_s = float(rng.uniform(0.0, 0.8 * duration_s))
    if kind == "departure":
        climb = Waypoint(*FIXES["OUTBD"], 1_000.0, 100.0)
        last = FIXES[rng.choice(DEPARTURES_TO)]
        cruise = Waypoint(*last, rng.integers(10, 22) * _LEVEL_M, rng.uniform(130.0, 190.0))
        return start_s, (Waypoint(*AIRPORT, ELEVATION_M, 80.0), climb, cruise)
    under_way = rng.random() < 0.5
    share = rng.uniform(0.0, 0.7) if under_way else 0.0
    if under_way:
        start_s = 0.0
    if kind == "arrival":
        start = between(FIXES[rng.choice(ARRIVALS_FROM)], FIXES["INBND"], share)
        height_m = 1_500.0 + (1.0 - share) * rng.integers(3, 9) * _LEVEL_M
        return start_s, (
            Waypoint(*start, height_m, rng.uniform(120.0, 150.0)),
            Waypoint(*FIXES["INBND"], 1_500.0, 100.0),
            Waypoint(*FIXES["FINAL"], 750.0, 80.0),
            Waypoint(*AIRPORT, ELEVATION_M, 70.0),
        )
    fixes = [FIXES[name] for name in AIRWAYS[rng.integers(len(AIRWAYS))]]
    if rng.random() < 0.5:
        fixes.reverse()
    start = between(fixes[0], fixes[1], share)
    level_m = float(rng.integers(10, 30) * _LEVEL_M)
    return start_s, _level([start, *fixes[1:]], level_m, rng.uniform(130.0, 210.0))


def _level(places: Sequence[Place], altitude_m: float, airspeed: float) -> tuple[Waypoint, ...]:
    return tuple(Waypoint(*place, altitude_m, airspeed) for place in places)


def _plan(flight: Flight, duration_s: float, wind: tuple[float, float]) -> Floats:
    """Return the flight's states every two seconds, columns as in `State`; NaN before and after."""
    air = AirSpace([flight], wind)
    absent = (np.nan,) * 6
    rows = []
    for second in range(0, round(duration_s) + 1, _PLAN_STEP_S):
        air.advance_to(second * SECOND)
        rows.append(air.state(0) or absent)
    return np.array(rows)


@jit
def _meet(ours: Floats, theirs: Floats) -> bool:
    """Return whether two plans violate the separation of flow control."""
    for i in range(len(ours)):
        if is_threat(theirs[i] - ours[i], _PLAN_TAU_S, _PLAN_DISTANCE_M, _PLAN_HEIGHT_M):
            return True
    return False
