import math

import numpy as np
import pytest

from oracle_pipeline.bags.types import serialize
from sim.atc.airspace import AircraftState, AirSpace, Flight, Waypoint
from sim.atc.geodesy import AIRPORT, Place, destination, distance, slant_range, to_geodetic
from sim.atc.sensors import (
    ADSB_TYPE,
    ALTITUDE_STEP_M,
    FALSE_PLOTS,
    PRIMARY,
    SECONDARY,
    TURN_S,
    AdsbReceiver,
    PrimaryRadar,
    RadarErrors,
    SecondaryRadar,
    Transponder,
)
from sim.middleware import qos
from sim.middleware.stamps import stamp_ns
from tests.sim.atc.tower import Tower

WHO = [Transponder("C07AB1", "ACA123", "2001"), Transponder("C07ADA", "UAL180", "2010")]
EXACT = RadarErrors(0.0, 0.0, 1.0)


def states(*rows):
    """A measurement of aircraft that stand still or move, as (x, y, altitude, vx, vy, vz)."""
    return lambda: (np.arange(len(rows)), np.array(rows, np.float64).reshape(-1, 6))


def still(x, y, altitude_m=5_000.0):
    return (x, y, altitude_m, 0.0, 0.0, 0.0)


def rng(seed=1):
    return np.random.default_rng(seed)


def replies(measure, seconds, errors=EXACT):
    tower = Tower()
    heard = tower.record("/ssr", "SecondaryReply")
    SecondaryRadar(tower.domain, WHO, measure, errors, rng())
    tower.run_until(seconds)
    return heard


def echoes(measure, seconds, errors=EXACT):
    tower = Tower()
    heard = tower.record("/psr", "RadarPlot")
    PrimaryRadar(tower.domain, measure, errors, rng())
    tower.run_until(seconds)
    return heard


def received(measure, seconds, who=WHO, seed=1):
    tower = Tower()
    heard = tower.record("/adsb", "AdsbReport")
    AdsbReceiver(tower.domain, who, measure, rng(seed))
    tower.run_until(seconds)
    return heard


def test_a_radar_without_errors_reports_exact_range_azimuth_and_time():
    east, south = still(30_000.0, 0.0), still(0.0, -40_000.0, 8_000.0)
    first, second = replies(states(east, south), TURN_S)
    assert first.slant_range_m == slant_range(30_000.0, 5_000.0)
    assert first.azimuth_deg == pytest.approx(90.0)
    assert stamp_ns(first.header.stamp) == pytest.approx(TURN_S / 4 * 1e9, abs=1)
    assert (first.icao24, first.squawk) == ("C07AB1", "2001")
    assert second.slant_range_m == slant_range(40_000.0, 8_000.0)
    assert second.azimuth_deg == pytest.approx(180.0)
    assert second.icao24 == "C07ADA"


def test_a_plot_shows_where_the_aircraft_was_when_the_beam_passed():
    moving = AircraftState(20_000.0, 40_000.0, 5_000.0, 200.0, 0.0, 0.0)  # at the sector's end
    (heard,) = replies(states(moving), TURN_S)
    ago_s = TURN_S / 8 - stamp_ns(heard.header.stamp) / 1e9  # the sector ends at 45 degrees
    assert ago_s == pytest.approx((45.0 - math.degrees(math.atan2(2, 4))) / 360.0 * TURN_S)
    x = moving.x - ago_s * moving.vx
    assert heard.azimuth_deg == pytest.approx(math.degrees(math.atan2(x, moving.y)))


def test_a_turning_radar_sees_every_aircraft_once_a_turn():
    heard = replies(states(still(30_000.0, 1.0), still(-50_000.0, 2.0)), 10 * TURN_S)
    assert [reply.icao24 for reply in heard] == ["C07AB1", "C07ADA"] * 10
    stamps = [stamp_ns(reply.header.stamp) for reply in heard[::2]]
    np.testing.assert_allclose(np.diff(stamps), TURN_S * 1e9, atol=2)


def test_transponders_report_altitude_in_steps_of_25_ft():
    for altitude_m in (5_000.0, 5_003.0, 93.0):
        (reply,) = replies(states(still(30_000.0, 0.0, altitude_m)), TURN_S)
        steps = reply.altitude_m / ALTITUDE_STEP_M
        assert steps == pytest.approx(round(steps))
        assert abs(reply.altitude_m - altitude_m) <= ALTITUDE_STEP_M / 2


def test_a_radar_sees_nothing_above_itself_and_nothing_too_far():
    assert replies(states(still(4_000.0, 0.0, 5_000.0)), 5 * TURN_S) == []
    assert replies(states(still(120_000.0, 0.0)), 5 * TURN_S) == []
    assert len(replies(states(still(6_000.0, 0.0, 5_000.0)), 5 * TURN_S)) == 5


@pytest.mark.parametrize("errors", [PRIMARY, SECONDARY])
def test_the_errors_of_a_radar_are_those_of_its_standard(errors):
    turns = 1_000
    heard = replies(states(still(0.0, -50_000.0)), turns * TURN_S, errors)
    assert len(heard) == pytest.approx(errors.detection * turns, abs=40)
    ranges = np.array([reply.slant_range_m for reply in heard])
    azimuths = np.array([reply.azimuth_deg for reply in heard])
    assert ranges.mean() == pytest.approx(slant_range(50_000.0, 5_000.0), abs=20.0)
    assert ranges.std() == pytest.approx(errors.range_sd_m, rel=0.1)
    assert azimuths.mean() == pytest.approx(180.0, abs=0.02)
    assert azimuths.std() == pytest.approx(errors.azimuth_sd_deg, rel=0.1)


def test_the_primary_radar_has_false_plots():
    turns = 500
    clutter = echoes(states(), turns * TURN_S)
    assert len(clutter) == pytest.approx(FALSE_PLOTS * turns, rel=0.1)
    azimuths = np.array([echo.azimuth_deg for echo in clutter])
    assert np.histogram(azimuths, 8, (0.0, 360.0))[0].min() > 0.7 * len(clutter) / 8
    stamps = np.array([stamp_ns(echo.header.stamp) for echo in clutter]) / 1e9
    np.testing.assert_allclose(stamps % TURN_S / TURN_S * 360.0, azimuths, atol=1e-3)


def test_ads_b_reports_about_twice_a_second_and_loses_one_squitter_in_twenty():
    measure = {0: AircraftState(*still(10_000.0, 0.0)), 1: None}.get
    heard = received(measure, 1_000.0)
    assert {report.icao24 for report in heard} == {"C07AB1"}
    assert len(heard) == pytest.approx(2 * 0.95 * 1_000, rel=0.02)
    pauses = np.diff([stamp_ns(report.header.stamp) for report in heard]) / 1e9
    assert pauses.min() >= 0.4
    assert np.median(pauses) == pytest.approx(0.5, abs=0.02)
    assert ((pauses <= 0.6) | (pauses >= 0.8)).all()


def test_ads_b_positions_are_within_30_m_in_95_of_100_reports_and_change_slowly():
    state = AircraftState(10_000.0, 30_000.0, 5_000.0, 120.0, 160.0, 0.0)
    here = Place(*to_geodetic(state.x, state.y))
    errors = []
    for seed in range(40):
        heard = received(lambda _: state, 120.0, WHO[:1], seed)
        off = [distance(here, Place(report.latitude, report.longitude)) for report in heard]
        errors += off
        assert np.abs(np.diff(off)).max() < 15.0
        speeds = np.array([report.ground_speed for report in heard])
        assert speeds.mean() == pytest.approx(200.0, abs=1.0)
    errors = np.array(errors)
    assert (errors < 30.0).mean() > 0.95
    assert (errors < 10.0).mean() < 0.95


def test_ads_b_tracks_are_from_true_north():
    # Due away from the airport, far in the east: north there is not the plane's y axis.
    there = destination(AIRPORT, 90.0, 80_000.0)
    x, y = 79_998.0, 0.0
    state = AircraftState(x, y, 5_000.0, 200.0, 0.0, 0.0)
    tracks = [report.track_deg for report in received(lambda _: state, 300.0, WHO[:1])]
    onward = destination(AIRPORT, 90.0, 80_100.0)
    bearing = math.degrees(
        math.atan2(
            (onward.longitude - there.longitude) * math.cos(math.radians(there.latitude)),
            onward.latitude - there.latitude,
        )
    )
    assert np.mean(tracks) == pytest.approx(bearing, abs=0.1)
    assert np.mean(tracks) > 90.5


def test_a_report_is_recorded_as_it_is_received():
    tower = Tower()
    heard, recorded = tower.record("/adsb", "AdsbReport"), []
    tower.create_subscription(ADSB_TYPE, "/adsb", recorded.append, qos.SENSOR_DATA, raw=True)
    flight = Flight(
        "C07AB1", "ACA123", "2001", 0.0,
        (Waypoint(44.0, -77.0, 3_000.0, 150.0), Waypoint(*AIRPORT, 3_000.0, 150.0)),
    )  # fmt: skip
    AdsbReceiver(tower.domain, WHO[:1], AirSpace([flight], (0.0, 0.0)).state, rng())
    tower.run_until(20.0)
    assert len(heard) > 30
    assert [serialize(report, ADSB_TYPE) for report in heard] == recorded
