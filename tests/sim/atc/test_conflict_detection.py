import math

import pytest

from sim.atc.conflict_detection import ConflictDetection
from sim.atc.display import ControllerDisplay
from tests.sim.atc.tower import Tower, track, tracks

CLEAR, TRAFFIC, RESOLUTION = 0, 1, 2


def head_on(seconds, apart_m=0.0):
    """Two aircraft at 6000 m, at first 60 km apart, that meet over the airport after 150 s."""
    x = 30_000.0 - 200.0 * seconds
    return (
        track(-x, 0.0, 6_000.0, 200.0, 90.0, "C07AB1"),
        track(x, 0.0, 6_000.0 + apart_m, 200.0, 270.0, "C07ADA"),
    )


def watched(apart_m=0.0, seconds=200):
    """Advisories by second, and the display's messages."""
    tower = Tower()
    ConflictDetection(tower.domain)
    ControllerDisplay(tower.domain)
    advisories = tower.record("/advisories", "Advisory")
    screens = tower.record("/display_state", "DisplayState")
    for second in range(seconds):
        tower.run_until(second)
        tower.publish("/tracks", tracks(second, *head_on(second, apart_m)))
    tower.run_until(seconds)
    return advisories, screens


def seconds_of(advisories, level):
    return [a.header.stamp.sec for a in advisories if a.level == level and a.icao24 == "C07AB1"]


def test_two_aircraft_on_a_collision_course_are_warned_at_the_computed_times():
    # At 6000 m tau is 45 s (traffic) and 30 s (resolution), DMOD 1852 m and 1481.6 m; with a
    # closing speed of 400 m/s, r^2 - 400 tau r - DMOD^2 = 0 at 18188.6 m and 12180.2 m, which is
    # after 104.5 s and 119.5 s. They are apart by DMOD again 4.63 s after they met.
    advisories, _ = watched()
    assert seconds_of(advisories, TRAFFIC) == [*range(105, 120), 154]
    assert seconds_of(advisories, RESOLUTION) == list(range(120, 154))
    assert seconds_of(advisories, CLEAR) == [155]


def test_an_advisory_states_position_and_time_of_the_intruder():
    advisories, _ = watched(apart_m=-100.0)
    first = next(a for a in advisories if a.icao24 == "C07AB1")
    assert (first.intruder, first.level, first.sense) == ("C07ADA", TRAFFIC, 0)
    assert first.range_m == pytest.approx(60_000.0 - 400.0 * 105, abs=1.0)
    assert first.relative_altitude_m == pytest.approx(-100.0)
    assert first.tau_s == pytest.approx((18_000.0**2 - 1_852.0**2) / (18_000.0 * 400.0), abs=0.01)


@pytest.mark.parametrize("apart_m", [-100.0, 0.0, 100.0])
def test_resolutions_send_one_up_and_the_other_down(apart_m):
    advisories, _ = watched(apart_m)
    senses = {}
    for advisory in advisories:
        if advisory.level == RESOLUTION:
            senses.setdefault(advisory.icao24, set()).add(advisory.sense)
    own, other = senses["C07AB1"], senses["C07ADA"]
    assert {*own, *other} == {-1, 1}
    assert len(own) == len(other) == 1
    if apart_m:
        assert own == {-math.copysign(1, apart_m)}


def test_a_thousand_feet_apart_there_is_no_advisory():
    advisories, screens = watched(apart_m=304.8)
    assert advisories == []
    assert {screen.traffic_advisories for screen in screens} == {0}


def test_the_display_counts_advisories_in_force_and_labels_every_track():
    _, screens = watched()
    by_second = {screen.header.stamp.sec: screen for screen in screens}
    assert by_second[0].labels == ["C07AB1 197 39", "C07ADA 197 39"]
    assert by_second[110].traffic_advisories == 2
    assert by_second[130].resolution_advisories == 2
    assert by_second[130].traffic_advisories == 0
    assert by_second[160].resolution_advisories == by_second[160].traffic_advisories == 0


def test_the_display_marks_tracks_that_only_some_sensors_detect():
    tower = Tower()
    ControllerDisplay(tower.domain)
    screens = tower.record("/display_state", "DisplayState")
    seen = [track(0.0, 0.0, math.nan, 100.0, 0.0, name, sources=s)
            for name, s in (("A", 7), ("B", 1), ("C", 6), ("", 2), ("E", 1), ("F", 5))]  # fmt: skip
    tower.publish("/tracks", tracks(1, *seen))
    tower.run_until(1.0)
    (screen,) = screens
    assert (screen.adsb_only, screen.radar_only) == (2, 2)
    assert screen.labels[0] == "A --- 19"
    assert screen.labels[3] == "------ --- 19"
