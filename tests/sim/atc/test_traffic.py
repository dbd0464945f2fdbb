import numpy as np
import pytest

from oracle_pipeline.bags.errors import OracleError
from sim.atc import traffic
from sim.atc.airspace import AirSpace
from sim.atc.geodesy import AIRPORT, Place, distance
from sim.atc.recipes import AtcRecipe
from sim.atc.tcas import advisories
from sim.atc.traffic import FIXES, draw_traffic
from sim.campaigns import Campaign
from sim.experiments import recipe_for
from sim.middleware.executor import SECOND
from sim.modes import modes

BLOCKS = range(4)
CAMPAIGN = Campaign()
NORMAL = modes()["atc_normal"]


@pytest.fixture(scope="module")
def recipes():
    return [recipe_for(NORMAL, block, CAMPAIGN) for block in BLOCKS]


def test_the_same_seed_draws_the_same_recipe_and_blocks_differ(recipes):
    assert recipe_for(NORMAL, 1, CAMPAIGN) == recipes[1]
    assert len({recipe.flights for recipe in recipes}) == len(recipes)
    assert recipe_for(NORMAL, 1, Campaign(seed=7)).flights != recipes[1].flights


def test_a_recipe_comes_back_from_json(recipes):
    for recipe in recipes:
        assert AtcRecipe.from_dict(recipe.to_dict()) == recipe


def test_modes_of_a_block_have_the_same_flights_session_and_noise(recipes):
    other = recipe_for(modes()["atc_deadzone"], 2, CAMPAIGN)
    assert (other.flights, other.session) == (recipes[2].flights, recipes[2].session)
    draws = [r.generator("/primary_radar").random(4) for r in (other, recipes[2])]
    np.testing.assert_array_equal(*draws)
    assert not np.array_equal(draws[0], other.generator("/secondary_radar").random(4))


def test_no_planned_flight_would_ever_raise_an_advisory(recipes):
    for recipe in recipes:
        air = AirSpace(recipe.flights, recipe.session.wind)
        for second in range(615):
            air.advance_to(second * SECOND)
            assert advisories(air.in_the_air()[1]) == []


def test_no_two_aircraft_share_an_address_a_callsign_or_a_squawk(recipes):
    for recipe in recipes:
        for field in ("icao24", "callsign", "squawk"):
            assert len({getattr(flight, field) for flight in recipe.flights}) == 10
        first = recipe.flights[0]
        assert (first.icao24, first.callsign) == ("C07AB1", "ACA123")
        assert all(set(flight.squawk) <= set("01234567") for flight in recipe.flights)


def test_the_jet_overtakes_three_slower_aircraft_far_below(recipes):
    for recipe in recipes:
        air = AirSpace(recipe.flights, recipe.session.wind)
        nearest = dict.fromkeys((1, 2, 3), (np.inf, 0.0))
        for second in range(500):
            air.advance_to(second * SECOND)
            jet = air.state(0)
            for number, closest in nearest.items():
                other = air.state(number)
                apart = float(np.hypot(jet.x - other.x, jet.y - other.y))
                nearest[number] = min(closest, (apart, jet.altitude_m - other.altitude_m))
        for number, (apart, below) in nearest.items():
            assert apart < 300.0
            assert below == pytest.approx(600.0 * number)


def test_all_aircraft_fly_within_the_radars_range(recipes):
    for recipe in recipes:
        for flight in recipe.flights:
            assert all(
                distance(AIRPORT, Place(p.latitude, p.longitude)) < 100_000.0 for p in flight.route
            )
    assert all(distance(AIRPORT, place) < 100_000.0 for place in FIXES.values())


def test_a_full_airspace_is_an_error(monkeypatch):
    monkeypatch.setattr(traffic, "_DRAWS", 1)  # else it takes nine hundred flights
    with pytest.raises(OracleError, match=r"no room for flight \d+ of 80"):
        draw_traffic(np.random.default_rng(0), 80, 600.0, (0.0, 0.0))
