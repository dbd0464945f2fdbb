"""Effects of the built-in scenarios of air traffic on messages."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.fuzzing.functions import haversine_m
from tests.sim.fuzzing.workbench import builtin, report, results, stamp, start

TARGET = "C07AB1"


def reports(name, *messages, **parameters):
    return results(builtin(name), messages, **parameters)


def published(found):
    return [[output for _, output, _ in result.outputs] for result in found]


def test_deletion_by_address_takes_one_aircraft_only():
    mine, other = report(0), report(1, "C07AB2")
    assert published(reports("atc_delete_by_id", mine, other)) == [[], [other]]


def test_padding_of_a_text_does_not_save_an_aircraft():
    assert published(reports("atc_delete_by_id", report(0, f"{TARGET} \0"))) == [[]]


def test_deletion_for_a_while_begins_and_ends():
    messages = [report(n, callsign="ACA123") for n in range(11)]
    found = reports("atc_delete_timer_callsign", *messages, start_s=0.4, length_s=1.0)
    assert [len(outputs) for outputs in published(found)] == [1, 1, 0, 0, 0, 0, 0, 1, 1, 1, 1]


def test_a_dead_zone_is_a_circle_on_the_earth():
    near = report(0, latitude=44.2253 + 0.04, longitude=-76.5967)
    far = report(1, latitude=44.2253 + 0.05, longitude=-76.5967)
    assert published(reports("atc_deadzone", near, far)) == [[], [far]]


def test_a_static_ghost_is_reported_every_second_under_new_stamps():
    execution = start(builtin("atc_ghost_static"))
    real = report(0, "REAL")
    assert execution.on_message(real, stamp(0), 0.0).outputs[0].message is real
    assert execution.timer_period_ns == 1_000_000_000
    ((_, ghost, _),) = execution.on_timer(stamp(9), 1.8).outputs
    assert (ghost.icao24, ghost.latitude, ghost.altitude_m) == ("GHOST1", 44.25, 1500.0)
    assert ghost.header == report(9).header


@given(st.floats(-60, 60), st.floats(-170, 170), st.floats(0, 360))
def test_a_following_ghost_is_behind_its_leader(latitude, longitude, track):
    leader = report(0, latitude=latitude, longitude=longitude, track_deg=track, altitude_m=900.0)
    (outputs,) = published(reports("atc_ghost_following", leader, behind_m=3000.0))
    real, ghost = outputs
    assert real is leader
    assert (ghost.icao24, ghost.altitude_m, ghost.header) == ("GHOST2", 900.0, leader.header)
    distance = haversine_m(latitude, longitude, ghost.latitude, ghost.longitude)
    assert distance == pytest.approx(3000.0, rel=1e-6)


def test_a_sinking_report_never_goes_below_the_ground():
    messages = [report(n, altitude_m=10.0) for n in range(20)]
    found = published(reports("atc_altitude_decrease", *messages))
    altitudes = [outputs[0].altitude_m for outputs in found]
    assert altitudes == pytest.approx([max(0.0, 10.0 - n) for n in range(20)])


def test_an_altered_position_drifts_off_on_its_bearing():
    messages = [report(n, latitude=44.0, longitude=-76.0) for n in range(11)]
    ((last,),) = published(reports("atc_gps_alteration", *messages, drift_m_s=100.0))[10:]
    assert haversine_m(44.0, -76.0, last.latitude, last.longitude) == pytest.approx(200.0)
    assert last.longitude > -76.0


def test_the_follower_is_right_behind_the_nearest_other():
    near = report(0, "NEAR", latitude=44.1, longitude=-76.0, track_deg=0.0, altitude_m=700.0)
    far = report(1, "FAR", latitude=45.0, longitude=-76.0)
    mine = report(2, TARGET, latitude=44.0, longitude=-76.0)
    ((follower,),) = published(reports("atc_follow_closest", near, far, mine, gap_m=500.0))[2:]
    assert follower.altitude_m == 700.0
    assert haversine_m(44.1, -76.0, follower.latitude, follower.longitude) == pytest.approx(500.0)
    assert follower.latitude < 44.1


def test_the_follower_drops_aircraft_without_recent_reports():
    execution = start(builtin("atc_follow_closest"))
    execution.on_message(report(0, "GONE"), stamp(0), 0.0)
    later = 200
    message = report(later)
    result = execution.on_message(message, stamp(later), 0.2 * later)
    assert result.outputs[0].message is message
