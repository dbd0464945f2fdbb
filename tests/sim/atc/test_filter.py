import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.atc.filter import MotionFilter

metres = st.floats(-1e4, 1e4)
sds = st.floats(1.0, 200.0)
measurements = st.lists(st.tuples(st.floats(0.01, 10.0), metres, metres, sds), max_size=12)


def textbook(first, measurements, velocity_sd, noise):
    """The same along one axis, with matrices."""
    x, P = np.array([first, 0.0]), np.diag([50.0**2, velocity_sd**2])
    H = np.array([[1.0, 0.0]])
    for dt, z, sd in measurements:
        F = np.array([[1.0, dt], [0.0, 1.0]])
        x = F @ x
        P = F @ P @ F.T + noise * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        K = P @ H.T / (H @ P @ H.T + sd**2)
        x = x + K @ (z - H @ x)
        P = (np.eye(2) - K @ H) @ P
    return x, P


@given(metres, metres, measurements, st.floats(1.0, 150.0), st.floats(0.1, 50.0))
def test_the_filter_is_kalmans_along_each_axis(east, north, measured, velocity_sd, noise):
    motion = MotionFilter(0, complex(east, north), 0j, 50.0, velocity_sd, noise)
    now_ns = 0
    for index, (pause_s, x, y, sd) in enumerate(measured):
        before_ns, now_ns = now_ns, now_ns + round(pause_s * 1e9)
        measured[index] = ((now_ns - before_ns) * 1e-9, x, y, sd)
        motion.update(now_ns, complex(x, y), sd)
    axes = [[(dt, x, sd) for dt, x, _, sd in measured], [(dt, y, sd) for dt, _, y, sd in measured]]
    (x, P), (y, _) = (
        textbook(first, axis, velocity_sd, noise)
        for first, axis in zip((east, north), axes, strict=True)
    )
    assert motion.position == pytest.approx(complex(x[0], y[0]), rel=1e-6, abs=1e-6)
    assert motion.velocity == pytest.approx(complex(x[1], y[1]), rel=1e-6, abs=1e-6)
    aside = motion.position + 100.0
    assert motion.distance_squared(now_ns, aside, 30.0) == pytest.approx(
        100.0**2 / (P[0, 0] + 30.0**2)
    )


def test_an_exact_velocity_settles_the_velocity():
    motion = MotionFilter(0, 0j, 0j, 10.0, 150.0, 1.0)
    motion.update_velocity(100.0 + 50.0j, 1e-6)
    assert motion.at(2_000_000_000) == pytest.approx(200.0 + 100.0j)


def test_a_measurement_older_than_the_last_is_compared_with_the_former_position():
    motion = MotionFilter(10**9, 1_000.0 + 0j, 100.0 + 0j, 10.0, 1.0, 1.0)
    motion.update(5 * 10**8, 950.0 + 0j, 10.0)
    assert motion.time_ns == 10**9
    assert motion.position == pytest.approx(1_000.0 + 0j)
