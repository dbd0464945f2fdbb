"""A constant-velocity Kalman filter for the position or the altitude of a track.

A position is a complex number, east + i north. Both axes have the same errors, so they share one
covariance of position and velocity. An altitude is a real number.
"""

from typing import Generic, TypeVar

Position = TypeVar("Position", complex, float)


class MotionFilter(Generic[Position]):
    """Estimate of a position and its velocity.

    Parameters
    ----------
    time_ns
        When it was measured for the first time.
    position, velocity
        First estimate [m, m/s].
    position_sd, velocity_sd
        Its standard deviation along each axis.
    noise
        Spectral density of the acceleration [m^2/s^3].
    """

    __slots__ = ("_noise", "_pp", "_pv", "_vv", "position", "time_ns", "velocity")

    def __init__(
        self,
        time_ns: int,
        position: Position,
        velocity: Position,
        position_sd: float,
        velocity_sd: float,
        noise: float,
    ) -> None:
        self.time_ns = time_ns
        self.position: Position = position
        self.velocity: Position = velocity
        self._pp, self._pv, self._vv = position_sd**2, 0.0, velocity_sd**2
        self._noise = noise

    def at(self, time_ns: int) -> Position:
        """Return the position expected at a time [ns]."""
        expected: Position = self.position + (time_ns - self.time_ns) * 1e-9 * self.velocity
        return expected

    def distance_squared(self, time_ns: int, position: Position, position_sd: float) -> float:
        """Return the squared distance of a measured from the expected position, in variances."""
        apart = abs(position - self.at(time_ns))
        return apart**2 / (self._variance(time_ns) + position_sd**2)

    def update(self, time_ns: int, position: Position, position_sd: float) -> None:
        """Update with a measured position; an older one is compared at its own time."""
        innovation = position - self.at(time_ns)
        self._predict(time_ns)
        variance = self._pp + position_sd**2
        gain_p, gain_v = self._pp / variance, self._pv / variance
        self.position += gain_p * innovation
        self.velocity += gain_v * innovation
        self._vv -= gain_v * self._pv
        self._pv *= 1.0 - gain_p
        self._pp *= 1.0 - gain_p

    def update_velocity(self, velocity: Position, velocity_sd: float) -> None:
        """Update with a velocity that was measured together with the last position."""
        innovation = velocity - self.velocity
        variance = self._vv + velocity_sd**2
        gain_p, gain_v = self._pv / variance, self._vv / variance
        self.position += gain_p * innovation
        self.velocity += gain_v * innovation
        self._pp -= gain_p * self._pv
        self._pv *= 1.0 - gain_v
        self._vv *= 1.0 - gain_v

    def _variance(self, time_ns: int) -> float:
        """Return the variance of the position expected at a time [ns]."""
        dt = max(time_ns - self.time_ns, 0) * 1e-9
        return self._pp + dt * (2.0 * self._pv + dt * self._vv) + self._noise * dt**3 / 3.0

    def _predict(self, time_ns: int) -> None:
        if time_ns <= self.time_ns:
            return
        dt = (time_ns - self.time_ns) * 1e-9
        self.position, self._pp = self.at(time_ns), self._variance(time_ns)
        self._pv += dt * self._vv + self._noise * dt**2 / 2.0
        self._vv += self._noise * dt
        self.time_ns = time_ns
