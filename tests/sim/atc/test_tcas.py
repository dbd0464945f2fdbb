import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.atc.tcas import CLEAR, RESOLUTION, TRAFFIC, advisories, advisory, modified_tau

FT, NM = 0.3048, 1852.0


def relative(dx=0.0, dy=0.0, dz=0.0, dvx=0.0, dvy=0.0, dvz=0.0):
    return np.array([dx, dy, dz, dvx, dvy, dvz])


@pytest.mark.parametrize(
    ("altitude_ft", "traffic_nm", "resolution_nm"),
    [
        (500, 0.30, None),
        (2_000, 0.33, 0.20),
        (4_000, 0.48, 0.35),
        (7_000, 0.75, 0.55),
        (15_000, 1.00, 0.80),
        (30_000, 1.30, 1.10),
        (43_000, 1.30, 1.10),
    ],
)
def test_aircraft_abreast_are_warned_within_the_radius_of_their_altitude(
    altitude_ft, traffic_nm, resolution_nm
):
    def level(distance_nm):
        return advisory(relative(dx=distance_nm * NM), altitude_ft * FT)[0]

    assert level(traffic_nm + 0.01) == CLEAR
    assert level(traffic_nm - 0.01) == TRAFFIC
    if resolution_nm is None:
        assert level(0.0) == TRAFFIC
    else:
        assert level(resolution_nm + 0.01) == TRAFFIC
        assert level(resolution_nm - 0.01) == RESOLUTION


@pytest.mark.parametrize(
    ("dz_ft", "level"), [(599, RESOLUTION), (601, TRAFFIC), (849, TRAFFIC), (851, CLEAR)]
)
def test_height_keeps_aircraft_apart(dz_ft, level):
    for sign in (-1, 1):
        assert advisory(relative(dz=sign * dz_ft * FT), 15_000 * FT)[0] == level


def test_a_climb_towards_an_aircraft_above_is_a_threat_before_the_heights_are_close():
    # 300 m apart, closing at 8 m/s: 37.5 s, within the 45 s of a traffic advisory but not 30 s.
    assert advisory(relative(dz=300.0, dvz=-8.0), 15_000 * FT)[0] == TRAFFIC
    assert advisory(relative(dz=300.0, dvz=8.0), 15_000 * FT)[0] == CLEAR
    assert advisory(relative(dz=300.0, dvz=-11.0), 15_000 * FT)[0] == RESOLUTION


def test_modified_tau_of_a_head_on_encounter():
    # (20000^2 - 1852^2) / (20000 * 400)
    assert modified_tau(20_000.0, 0.0, -400.0, 0.0, 1_852.0) == pytest.approx(49.571, abs=1e-3)
    assert modified_tau(20_000.0, 0.0, 400.0, 0.0, 1_852.0) == math.inf
    assert modified_tau(1_000.0, 0.0, 400.0, 0.0, 1_852.0) == 0.0


numbers = st.floats(-2e4, 2e4)
speeds = st.floats(-250.0, 250.0)
states = st.tuples(numbers, numbers, st.floats(2_000.0, 2_800.0), speeds, speeds, speeds)


@given(states, states)
def test_at_one_sensitivity_two_aircraft_are_warned_of_each_other_alike(one, other):
    found = advisories(np.array([one, other]))
    assert {(own, intruder) for own, intruder, _, _ in found} in (set(), {(0, 1), (1, 0)})
    assert len({(level, tau) for _, _, level, tau in found}) <= 1


def test_an_aircraft_of_unknown_altitude_is_no_threat():
    known = [0.0, 0.0, 3_000.0, 0.0, 0.0, 0.0]
    unknown = [0.0, 0.0, math.nan, 0.0, 0.0, 0.0]
    assert len(advisories(np.array([known, known]))) == 2
    assert advisories(np.array([known, unknown])) == []
    assert advisories(np.array([known])) == []
