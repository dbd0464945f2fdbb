from dataclasses import replace

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.bags.types import message_class
from oracle_pipeline.features.air_traffic import adsb_reports, fused_tracks
from oracle_pipeline.features.geometry.wgs84 import Site, cartesian
from tests.oracle_pipeline.features.scenery import extract, header

ANTENNA = Site(44.2253, -76.5967)
AIRCRAFT = {  # azimuth [deg] and distance [m] from the antenna, course [deg], altitude [m]
    "A00001": (10.0, 20_000.0, 90.0, 3_000.0),
    "A00002": (100.0, 40_000.0, 200.0, 5_000.0),
    "A00003": (200.0, 60_000.0, 10.0, 8_000.0),
    "A00004": (300.0, 12_000.0, 120.0, 4_000.0),
}
SPEED = 120.0
SECONDS = 60

_Report, _Reply, _Track, _Tracks, _Advisory = (
    message_class(f"atc_msgs/msg/{name}")
    for name in ("AdsbReport", "SecondaryReply", "Track", "TrackArray", "Advisory")
)


@pytest.fixture
def extracted(tmp_path_factory):
    """Return a function from messages to values, where they are, and what is missing."""
    plugins = [*adsb_reports.register_features(), *fused_tracks.register_features()]
    return lambda recorded: extract(plugins, recorded, tmp_path_factory.mktemp("bag"))


def place(address, time_s):
    """Latitude, longitude [deg] and course [deg] of an aircraft."""
    azimuth, distance, course, _ = AIRCRAFT[address]
    start = Geodesic.WGS84.Direct(ANTENNA.latitude, ANTENNA.longitude, azimuth, distance)
    now = Geodesic.WGS84.Direct(start["lat2"], start["lon2"], course, SPEED * time_s)
    return now["lat2"], now["lon2"], now["azi2"] % 360.0


def report(address, time_s):
    latitude, longitude, course = place(address, time_s)
    altitude_m = AIRCRAFT[address][3]
    # The ground speed is that of the place below the aircraft.
    return _Report(
        header(time_s, "wgs84"), address, "", latitude, longitude, altitude_m, SPEED, course
    )


def reply(address, time_s):
    latitude, longitude, _ = place(address, time_s)
    altitude_m = AIRCRAFT[address][3]
    seen, up_m = ANTENNA.seen(cartesian(latitude, longitude, altitude_m).reshape(3, 1))
    slant_m, azimuth_deg = np.hypot(np.abs(seen), up_m).item(), np.degrees(np.angle(seen)).item()
    return _Reply(
        header(time_s, "radar"), slant_m, azimuth_deg % 360.0, address, "7000", altitude_m
    )


def flown(change=lambda report: report, addresses=AIRCRAFT, topic="/adsb"):
    """Reports every half a second, changed (None: dropped), and replies every 5 s."""
    recorded = [
        (time_s, topic, changed)
        for time_s in np.arange(0.0, SECONDS, 0.5).tolist()
        for address in addresses
        if (changed := change(report(address, time_s))) is not None
    ]
    recorded += [
        (time_s + 0.2, "/ssr", reply(address, time_s + 0.2))
        for time_s in np.arange(0.0, SECONDS - 5, 5.0).tolist()
        for address in addresses
    ]
    return sorted(recorded, key=lambda each: each[0])


def seconds_of(message):
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


@given(st.floats(0.0, 359.0), st.floats(100.0, 100_000.0))
def test_azimuth_and_distance_are_those_of_the_geodesic(azimuth, distance):
    there = Geodesic.WGS84.Direct(ANTENNA.latitude, ANTENNA.longitude, azimuth, distance)
    seen, _ = ANTENNA.seen(cartesian(there["lat2"], there["lon2"], 0.0).reshape(3, 1))
    # At 100 km the plane lies 4 m inside of the arc.
    assert np.abs(seen) == pytest.approx(distance, rel=5e-5)
    assert np.exp(1j * np.angle(seen)) == pytest.approx(np.exp(1j * np.radians(azimuth)), abs=1e-5)


def test_up_is_the_altitude_overhead():
    above = cartesian(ANTENNA.latitude, ANTENNA.longitude, 1_000.0).reshape(3, 1)
    place_m, up_m = ANTENNA.seen(above)
    assert up_m == pytest.approx(1_000.0)
    assert np.abs(place_m) == pytest.approx(0.0, abs=1e-6)


@given(st.floats(-80, 80), st.floats(-179, 179), st.floats(0, 359), st.floats(1, 50_000))
def test_moving_a_site_by_an_offset_puts_it_at_that_offset(latitude, longitude, azimuth, distance):
    step = distance * np.exp(1j * np.radians(azimuth))
    there = Site(latitude, longitude).moved(complex(step))
    seen, _ = Site(latitude, longitude).seen(
        cartesian(there.latitude, there.longitude, 0.0).reshape(3, 1)
    )
    assert seen == pytest.approx(step, abs=2e-4 * distance + 1e-6)


def test_honest_reports_have_no_residuals(extracted):
    values, *_ = extracted(flown())
    assert values["position_residual"] < 1.0
    assert values["altitude_residual"] == pytest.approx(0.0, abs=1e-6)
    assert values["velocity_residual"] < 0.3
    assert values["report_interval"] == pytest.approx(0.5)
    assert values["report_gap"] == pytest.approx(0.5)
    assert values["appearances"] == values["disappearances"] == 0.0


def test_without_any_valid_report_nothing_is_computed(extracted):
    values, _, missing = extracted(flown(lambda report: replace(report, latitude=91.0)))
    assert np.isnan(values["appearances"])
    assert "two ADS-B reports" in missing["appearances"]


def test_a_false_position_is_found_and_does_not_move_the_antenna(extracted):
    def north(message):
        moved = message.icao24 == "A00002"
        return replace(message, latitude=message.latitude + 0.01) if moved else message

    values, where, _ = extracted(flown(north))
    assert values["position_residual"] == pytest.approx(1_111.0, rel=0.02)  # 0.01 deg
    assert where["position_residual"] == "/adsb A00002"
    assert values["velocity_residual"] < 0.3  # it moves as it says


def test_a_drifting_position_does_not_fit_its_velocity(extracted):
    def drift(message):
        if message.icao24 != "A00003":
            return message
        return replace(message, latitude=message.latitude + 9e-5 * seconds_of(message))

    values, where, _ = extracted(flown(drift))
    assert values["velocity_residual"] == pytest.approx(10.0, rel=0.02)  # 9e-5 deg/s
    assert where["velocity_residual"] == "/adsb A00003"


def test_a_false_altitude_is_found(extracted):
    def sink(message):
        sinks = message.icao24 == "A00001"
        return replace(message, altitude_m=message.altitude_m - 300.0) if sinks else message

    values, where, _ = extracted(flown(sink))
    assert values["altitude_residual"] == pytest.approx(300.0)
    assert where["altitude_residual"] == "/adsb A00001"


def test_aircraft_that_vanish_inside_the_airspace_are_counted(extracted):
    def vanish(message):
        return None if message.icao24 == "A00004" and seconds_of(message) > 30 else message

    def come(message):
        return None if message.icao24 == "A00004" and seconds_of(message) < 30 else message

    def go_at_the_border(message):
        return None if message.icao24 == "A00003" and seconds_of(message) > 30 else message

    gone, *_ = extracted(flown(vanish))
    came, *_ = extracted(flown(come))
    left, *_ = extracted(flown(go_at_the_border))
    assert (gone["appearances"], gone["disappearances"]) == (0.0, 1.0)
    assert (came["appearances"], came["disappearances"]) == (1.0, 0.0)
    assert (left["appearances"], left["disappearances"]) == (0.0, 0.0)


def test_silence_is_a_gap(extracted):
    def silence(message):
        return None if message.icao24 == "A00004" and 20 < seconds_of(message) < 29 else message

    values, where, _ = extracted(flown(silence))
    assert values["report_gap"] == pytest.approx(9.0)
    assert where["report_gap"] == "/adsb A00004"


def test_each_topic_of_reports_is_judged_by_itself(extracted):
    def sink(message):
        return replace(message, altitude_m=message.altitude_m - 300.0)

    both = flown() + [each for each in flown(sink, topic="/adsb_fuzzed") if each[1] != "/ssr"]
    values, where, _ = extracted(sorted(both, key=lambda each: each[0]))
    assert values["altitude_residual"] == pytest.approx(300.0)
    assert where["altitude_residual"].startswith("/adsb_fuzzed ")


def test_invalid_reports_are_left_out(extracted):
    def absurd(message):
        nowhere = message.icao24 == "A00004"
        return replace(message, latitude=float("nan")) if nowhere else message

    values, where, _ = extracted(flown(absurd))
    assert values["position_residual"] < 1.0
    assert "A00004" not in where["velocity_residual"]


def test_without_a_radar_the_reports_are_still_judged(extracted):
    values, _, missing = extracted([each for each in flown() if each[1] == "/adsb"])
    assert values["velocity_residual"] < 0.3
    assert "position_residual" in missing


def track(number, sources, latitude=44.0, altitude_m=1_000.0, speed=100.0, icao24="A"):
    return _Track(number, icao24, "", "", latitude, -76.0, altitude_m, speed, 0.0, 0.0, sources)


def tracks(time_s, *shown):
    return time_s, "/tracks", _Tracks(header(time_s, "wgs84"), list(shown))


def test_tracks_of_one_source_alone(extracted):
    recorded = [
        tracks(
            float(t),
            track(1, 7), track(2, 1 if t < 8 else 7, 45.0), track(3, 6, 46.0, icao24=""),
            track(4, 5, 47.0),
        )
        for t in range(10)
    ]  # fmt: skip
    values, *_ = extracted(recorded)
    assert values["adsb_only"] == pytest.approx(0.8 / 4)
    assert values["radar_only"] == values["nameless"] == pytest.approx(1 / 4)
    assert values["longest_adsb_only"] == pytest.approx(7.0)
    assert values["longest_radar_only"] == pytest.approx(9.0)


def test_tracks_that_fly_as_one(extracted):
    recorded = [
        tracks(float(t), track(1, 7), track(2, 7, 44.01, 1_300.0), track(3, 7, 45.0, speed=180.0))
        for t in range(10)
    ]
    values, *_ = extracted(recorded)
    metres = Geodesic.WGS84.Inverse(44.0, -76.0, 44.01, -76.0)["s12"]
    assert values["closest_pair"] == pytest.approx(np.hypot(metres, 300.0), rel=1e-4)
    assert values["closest_pair_speed"] == pytest.approx(0.0)


def test_one_track_has_no_pair(extracted):
    values, _, missing = extracted([tracks(float(t), track(1, 7)) for t in range(10)])
    assert values["adsb_only"] == 0.0
    assert "fewer than two tracks" in missing["closest_pair"]


def test_advisories_are_counted(extracted):
    advised = [
        (float(t), "/advisories", _Advisory(header(t, ""), level, "A", "B", 0.0, 0.0, 0.0, 0))
        for t, level in ((0, 1), (5, 1), (10, 2), (20, 0))
    ]
    values, *_ = extracted(advised)
    assert values["traffic_advisories"] == pytest.approx(2 * 3.0)
    assert values["resolution_advisories"] == pytest.approx(3.0)
