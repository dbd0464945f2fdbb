import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.atc.fusion import ADSB, PSR, SSR, Fusion
from sim.atc.geodesy import to_plane
from sim.middleware.stamps import header
from tests.sim.atc.tower import AdsbReport, RadarPlot, SecondaryReply, Tower, adsb, plot, reply

TURN_S = 4.8


class Scene:
    """Aircraft that fly east, and the tracks that the fusion computes from sensor reports."""

    def __init__(self):
        self.tower = Tower()
        Fusion(self.tower.domain)
        self.arrays = self.tower.record("/tracks", "TrackArray")

    def at(self, seconds, topic, make, **fields):
        """Publish a sensor's report of the aircraft flying at 200 m/s from (-40 km, 20 km)."""
        self.tower.run_until(seconds)
        x = fields.pop("x", -40_000.0 + 200.0 * seconds)
        y = fields.pop("y", 20_000.0)
        if make is adsb:
            # Twenty kilometres away, track and bearing in the plane differ by a fifth of a degree.
            fields = {"speed": 200.0, "track": 90.0, **fields}
        self.tower.publish(topic, make(seconds, x, y, **fields))

    def adsb(self, start, end, **fields):
        for half in range(round(2 * start), round(2 * end)):
            self.at(half / 2, "/adsb_fuzzed", adsb, **fields)

    def tracks_at(self, seconds):
        self.tower.run_until(seconds)
        return self.arrays[-1].tracks


def error_m(track, seconds):
    x, y = to_plane(track.latitude, track.longitude)
    return math.hypot(x - (-40_000.0 + 200.0 * seconds), y - 20_000.0)


def test_three_sources_of_one_aircraft_make_one_track():
    scene = Scene()
    for turn in range(5):
        scene.adsb(TURN_S * turn + 0.1, TURN_S * turn + 4.5)
        scene.at(TURN_S * turn + 4.6, "/ssr", reply)
        scene.at(TURN_S * turn + 4.6, "/psr", plot)
    (track,) = scene.tracks_at(24.0)
    assert (track.icao24, track.callsign, track.squawk) == ("C07AB1", "ACA123", "2001")
    assert track.sources == ADSB + PSR + SSR
    assert error_m(track, 24.0) < 30.0
    assert track.altitude_m == pytest.approx(5_000.0, abs=1.0)
    assert track.ground_speed == pytest.approx(200.0, abs=1.0)
    assert track.track_deg == pytest.approx(90.0, abs=0.5)
    assert track.vertical_rate == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize(("topic", "make", "source"), [("/ssr", reply, SSR), ("/psr", plot, PSR)])
def test_one_radar_alone_makes_a_track(topic, make, source):
    scene = Scene()
    for turn in range(6):
        scene.at(TURN_S * turn, topic, make)
    (track,) = scene.tracks_at(25.0)
    assert track.sources == source
    assert error_m(track, 25.0) < 150.0 if source == SSR else error_m(track, 25.0) < 600.0
    assert track.ground_speed == pytest.approx(200.0, rel=0.05)
    assert math.isnan(track.altitude_m) == (source == PSR)


def test_a_climb_is_seen():
    scene = Scene()
    for half in range(60):
        scene.at(half / 2, "/adsb_fuzzed", adsb, altitude_m=3_000.0 + 4.0 * half)
    (track,) = scene.tracks_at(30.0)
    assert track.vertical_rate == pytest.approx(8.0, abs=0.2)
    assert track.altitude_m == pytest.approx(3_240.0, abs=3.0)


def test_a_single_echo_is_no_track_and_is_forgotten():
    scene = Scene()
    scene.at(1.0, "/psr", plot, x=30_000.0, y=-30_000.0)
    for turn in range(4):
        scene.at(20.0 + TURN_S * turn, "/ssr", reply)
    assert [track.icao24 for track in scene.tracks_at(36.0)] == ["C07AB1"]


def test_an_aircraft_that_an_echo_found_first_keeps_its_track():
    scene = Scene()
    for turn in range(4):
        scene.at(TURN_S * turn, "/psr", plot, altitude_m=3_000.0)
    (nameless,) = scene.tracks_at(15.0)
    assert nameless.icao24 == ""
    scene.at(16.0, "/ssr", reply, altitude_m=3_000.0)
    (named,) = scene.tracks_at(17.0)
    assert (named.track_id, named.icao24) == (nameless.track_id, "C07AB1")


def test_an_echo_goes_to_the_nearer_of_two_aircraft():
    scene = Scene()
    for half in range(10):
        scene.at(half / 2, "/adsb_fuzzed", adsb)
        scene.at(half / 2, "/adsb_fuzzed", adsb, y=21_000.0, icao24="C07ADA")
    scene.at(5.0, "/psr", plot, y=20_900.0)
    sources = {track.icao24: track.sources for track in scene.tracks_at(6.0)}
    assert sources == {"C07AB1": ADSB, "C07ADA": ADSB + PSR}


def test_a_report_that_does_not_fit_is_left_out_and_three_in_a_row_move_the_track():
    scene = Scene()
    scene.adsb(0.0, 10.0)
    scene.at(10.0, "/ssr", reply, y=25_000.0)
    (track,) = scene.tracks_at(11.0)
    assert error_m(track, 11.0) < 10.0
    assert track.sources == ADSB
    scene.adsb(11.5, 12.5, y=30_000.0)
    (track,) = scene.tracks_at(12.9)
    assert error_m(track, 12.0) < 10.0
    scene.at(13.1, "/adsb_fuzzed", adsb, y=30_000.0)
    (track,) = scene.tracks_at(14.0)
    assert error_m(track, 14.0) == pytest.approx(10_000.0, abs=10.0)


def test_altitude_of_the_radar_is_left_out_while_ads_b_reports_another():
    scene = Scene()
    for turn in range(5):
        scene.adsb(TURN_S * turn + 0.1, TURN_S * turn + 4.5, altitude_m=3_000.0)
        scene.at(TURN_S * turn + 4.6, "/ssr", reply, altitude_m=5_000.0)
    (track,) = scene.tracks_at(24.0)
    assert track.altitude_m == pytest.approx(3_000.0, abs=1.0)
    assert track.vertical_rate == pytest.approx(0.0, abs=0.1)


def test_sources_are_those_of_the_last_two_turns_and_silence_ends_a_track():
    scene = Scene()
    scene.adsb(0.0, 10.0)
    scene.at(9.8, "/ssr", reply)
    assert scene.tracks_at(19.0)[0].sources == ADSB + SSR
    assert scene.tracks_at(20.0)[0].sources == 0
    assert scene.tracks_at(24.0)[0].icao24 == "C07AB1"
    assert scene.tracks_at(25.0) == []


numbers = st.floats() | st.floats(-400.0, 400.0) | st.floats(0.0, 1e5)
headers = st.builds(header, st.integers(0, 2**31 * 10**9 - 1), st.just("wgs84"))
addresses = st.sampled_from(["C07AB1", "GHOST1", ""])
anything = st.lists(
    st.one_of(
        st.builds(AdsbReport, headers, addresses, st.just("ACA123"), *[numbers] * 5),
        st.builds(RadarPlot, headers, numbers, numbers),
        st.builds(SecondaryReply, headers, numbers, numbers, addresses, st.just("2001"), numbers),
    ),
    max_size=30,
)
TOPICS = {AdsbReport: "/adsb_fuzzed", RadarPlot: "/psr", SecondaryReply: "/ssr"}


@given(anything)
def test_for_any_input_tracks_have_positions_and_correct_reports_are_used_again(messages):
    scene = Scene()
    for number, message in enumerate(messages):
        scene.tower.run_until(0.1 * number)
        scene.tower.publish(TOPICS[type(message)], message)
    scene.adsb(5.0, 12.0)
    last = scene.tracks_at(12.0)
    for track in (track for array in scene.arrays for track in array.tracks):
        assert math.isfinite(track.latitude + track.longitude + track.ground_speed)
        assert 0.0 <= track.track_deg <= 360.0
    (right,) = (track for track in last if track.icao24 == "C07AB1")
    assert error_m(right, 12.0) < 30.0
    assert right.altitude_m == pytest.approx(5_000.0, abs=10.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"altitude_m": math.nan},
        {"altitude_m": 1e300},
        {"speed": math.inf},
        {"track": -1.0},
        {"x": math.nan},
    ],
)
def test_impossible_sensor_reports_are_ignored(wrong):
    scene = Scene()
    for half in range(10):
        scene.at(half / 2, "/adsb_fuzzed", adsb, **wrong)
    assert scene.tracks_at(6.0) == []
