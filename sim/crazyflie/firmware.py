"""The Crazyflie's firmware, as far as a flight needs it: estimator, cascade of PIDs, mixer.

Structure, rates, signs, gains and limits are those of Bitcraze's ``crazyflie-firmware`` for the
platform cf2: position and velocity at 100 Hz, attitude and rates at 500 Hz, and the mixer of its
legacy mode. The extended Kalman filter is replaced by one with constant gains. Angles are degrees
and a positive pitch is nose up, as there.
"""

import math
from typing import NamedTuple

import numpy as np

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats
from sim.crazyflie.airframe import STEP_S, matrix

_EVERY_ATTITUDE, _EVERY_POSITION = 2, 10  # steps of a millisecond
_ATTITUDE_S, _POSITION_S = _EVERY_ATTITUDE * STEP_S, _EVERY_POSITION * STEP_S
_G = 9.81
_MOST = 32767.0  # of a command to the mixer
_FULL = 65535.0  # of thrust
_BASE, _LEAST = 36000.0, 20000.0  # of thrust: in a hover, and in flight
_LANDED_M = 0.03  # a setpoint below stops the motors
_GYRO_HZ, _ACCELERATION_HZ = 80.0, 30.0  # cutoffs of the filters
# Gains of the estimator, at each pose of motion capture: of position, velocity [1/s], attitude.
_PULL, _PULL_SPEED, _PULL_TURN = 0.2, 2.2, 0.03

# Each PID: kp, ki, kd, limit of the integral, limit of the output.
GAINS = np.array(
    [
        *[[2.0, 0.0, 0.0, 5000.0, 1.1]] * 2,  # x, y [m] to [m/s]
        [2.0, 0.5, 0.0, 5000.0, 1.1],  # z
        *[[25.0, 1.0, 0.0, 5000.0, 20.0]] * 2,  # velocity forward, left to pitch, roll [deg]
        [25.0, 15.0, 0.0, 5000.0, _MOST / 1000.0],  # climb to thrust [1000]
        *[[6.0, 3.0, 0.0, 20.0, np.inf]] * 2,  # roll, pitch to rates [deg/s]
        [6.0, 1.0, 0.35, 360.0, np.inf],  # yaw
        *[[250.0, 500.0, 2.5, 33.3, _MOST]] * 2,  # rates to commands
        [120.0, 16.7, 0.0, 166.7, _MOST],
    ]
)
# What motors 1 to 4 get of the commands of roll, pitch and yaw.
_MIXER = np.array([[-0.5, 0.5, 1.0], [-0.5, -0.5, -1.0], [0.5, -0.5, 1.0], [0.5, 0.5, -1.0]])
_X, _Y, _Z, _VX, _VY, _VZ, _ROLL, _PITCH, _YAW, _P, _Q, _R = range(12)

LOG = (
    *("cmd_thrust", "cmd_roll", "cmd_pitch", "cmd_yaw", "r_roll", "r_pitch", "r_yaw", "accelz"),
    *("actuatorThrust", "roll", "pitch", "yaw", "rollRate", "pitchRate", "yawRate"),
)
"""Variables of the log group ``controller``, in the order of `Firmware.log`."""


class State(NamedTuple):
    """Everything that the firmware remembers: views of one array, which is cheaper to pass."""

    position: Floats
    velocity: Floats
    quaternion: Floats  # w, x, y, z
    inertial: Floats  # (6,) filtered angular velocity and specific force
    filters: Floats  # (6, 2) of these
    pids: Floats  # (12, 2) integral and last measurement
    wanted: Floats  # (4,) thrust, roll, pitch, yaw
    log: Floats  # as `LOG`


_SIZE = 56 + len(LOG)


@jit
def _view(memory: Floats) -> State:
    """Return the parts of an array of shape (_SIZE,)."""
    return State(
        memory[:3], memory[3:6], memory[6:10], memory[10:16], memory[16:28].reshape((6, 2)),
        memory[28:52].reshape((12, 2)), memory[52:56], memory[56:],
    )  # fmt: skip


def _butterworth(cutoff_hz: float) -> Floats:
    """Return b0, a1 and a2 of a low-pass of second order."""
    c = math.tan(math.pi * cutoff_hz * STEP_S)
    norm = 1.0 + math.sqrt(2.0) * c + c * c
    return np.array([c * c, 2.0 * (c * c - 1.0), 1.0 - math.sqrt(2.0) * c + c * c]) / norm


_FILTERS = np.array([_butterworth(_GYRO_HZ)] * 3 + [_butterworth(_ACCELERATION_HZ)] * 3)


class Firmware:
    """The firmware of one Crazyflie.

    Parameters
    ----------
    position
        Of the frame when it is switched on, level and facing forward [m].
    gains
        All gains of the PIDs relative to `GAINS`.

    Attributes
    ----------
    state : State
        What it estimates and logs.
    duty : ndarray of shape (4,)
        Commands of the motors, from 0 to 1.
    is_tumbled : bool
        Whether it has stopped the motors for good.
    """

    def __init__(self, position: Floats, gains: float = 1.0) -> None:
        self._memory = np.zeros(_SIZE)
        self.state = _view(self._memory)
        self.state.position[:], self.state.quaternion[0], self.state.inertial[5] = position, 1.0, _G
        self._gains = GAINS * np.array([gains, gains, gains, 1.0, 1.0])
        self._setpoint = np.zeros(4)
        self._ticks = 0
        self.duty = np.zeros(4)
        self.is_tumbled = False

    def set_point(self, x: float, y: float, z: float, yaw_deg: float) -> None:
        """Fly to a position in the world [m]."""
        self._setpoint[:] = x, y, z, yaw_deg

    def locate(self, position: Floats, quaternion: Floats) -> None:
        """Take a pose that motion capture has measured."""
        _locate(self._memory, position, quaternion)

    def step(self, sample: Floats) -> Floats:
        """Take a sample of the inertial unit; return the commands of the motors, from 0 to 1."""
        flies = self._setpoint[2] >= _LANDED_M and not self.is_tumbled
        up = _step(self._memory, self._ticks, sample, self._gains, self._setpoint, flies, self.duty)
        self.is_tumbled |= flies and up < 0.0
        self._ticks += 1
        return self.duty


@jit
def _step(
    memory: Floats, tick: int, sample: Floats, gains: Floats, setpoint: Floats, flies: bool,
    duty: Floats,
) -> float:  # fmt: skip
    """Take a step, and return the upward part of the frame's z axis."""
    state = _view(memory)
    _filter(state, sample)
    up: float = _predict(state)
    if tick % _EVERY_ATTITUDE:
        return up
    roll, pitch, yaw = _angles(state.quaternion)
    rates = np.degrees(state.inertial[:3]) * np.array([1.0, -1.0, 1.0])
    if not flies:
        _stop(state, np.array([yaw, rates[0], rates[1], rates[2]]), duty)
        return up
    if tick % _EVERY_POSITION == 0:
        _position(state, gains, setpoint, math.radians(yaw))
    thrust, wanted = state.wanted[0], state.wanted[1:]
    now = np.array([roll, pitch, yaw])
    command = np.zeros(3)
    for axis in range(3):
        error = (wanted[axis] - now[axis] + 180.0) % 360.0 - 180.0
        rate = _pid(state.pids, gains, _ROLL + axis, error, now[axis], _ATTITUDE_S)
        command[axis] = _pid(
            state.pids, gains, _P + axis, rate - rates[axis], rates[axis], _ATTITUDE_S
        )
        state.log[12 + axis] = rate
    command[2] *= -1.0
    _mix(thrust, command, duty)
    state.log[0] = state.log[8] = thrust
    state.log[1:4], state.log[4:7], state.log[9:12] = command, np.radians(rates), wanted
    state.log[7] = state.inertial[5] / _G
    return up


@jit
def _pid(
    memory: Floats, gains: Floats, which: int, error: float, measured: float, period_s: float
) -> float:
    kp, ki, kd, most, limit = gains[which]
    integral = min(max(memory[which, 0] + error * period_s, -most), most)
    slope = (measured - memory[which, 1]) / period_s
    memory[which, 0], memory[which, 1] = integral, measured
    out: float = min(max(kp * error + ki * integral - kd * slope, -limit), limit)
    return out


@jit
def _position(state: State, gains: Floats, setpoint: Floats, yaw: float) -> None:
    """Compute thrust and attitude, in the frame turned by the yaw."""
    s, c = math.sin(yaw), math.cos(yaw)
    away, speed = setpoint[:3] - state.position, state.velocity
    errors = (c * away[0] + s * away[1], c * away[1] - s * away[0], away[2])
    speeds = (c * speed[0] + s * speed[1], c * speed[1] - s * speed[0], speed[2])
    out = np.zeros(3)
    for axis in range(3):
        wanted = _pid(state.pids, gains, _X + axis, errors[axis], 0.0, _POSITION_S)
        error = wanted - speeds[axis]
        out[axis] = _pid(state.pids, gains, _VX + axis, error, speeds[axis], _POSITION_S)
    thrust = min(max(1000.0 * out[2] + _BASE, _LEAST), _FULL)
    state.wanted[:] = np.array([thrust, -out[1], -out[0], setpoint[3]])


@jit
def _stop(state: State, measured: Floats, duty: Floats) -> None:
    """Stop the motors and forget the integrals."""
    state.pids[:] = 0.0
    state.pids[_YAW:, 1] = measured
    state.log[:] = 0.0
    state.log[4:7] = np.radians(measured[1:])
    state.log[7] = state.inertial[5] / _G
    duty[:] = 0.0


@jit
def _mix(thrust: float, command: Floats, duty: Floats) -> None:
    """Distribute the commands; all motors are reduced alike if one would exceed its maximum."""
    wanted = thrust + _MIXER @ command
    too_much = max(wanted.max() - _FULL, 0.0)
    duty[:] = np.maximum(wanted - too_much, 0.0) / _FULL


@jit
def _filter(state: State, sample: Floats) -> None:
    for i in range(6):
        b, a1, a2 = _FILTERS[i]
        older, last = state.filters[i]
        now = sample[i] - a1 * last - a2 * older
        state.inertial[i] = b * (now + 2.0 * last + older)
        state.filters[i, 0], state.filters[i, 1] = last, now


@jit
def _predict(state: State) -> float:
    """Carry the estimate on by a step; return the upward part of the frame's z axis."""
    w, x, y, z = state.quaternion
    p, q, r = 0.5 * STEP_S * state.inertial[:3]
    turned = np.array(
        [w - x * p - y * q - z * r, x + w * p + y * r - z * q, y + w * q + z * p - x * r,
         z + w * r + x * q - y * p]
    )  # fmt: skip
    state.quaternion[:] = turned / np.sqrt((turned**2).sum())
    rotation = matrix(state.quaternion)
    acceleration = rotation @ state.inertial[3:]
    acceleration[2] -= _G
    state.position[:] += STEP_S * state.velocity
    state.velocity[:] += STEP_S * acceleration
    return float(rotation[2, 2])


@jit
def _locate(memory: Floats, position: Floats, quaternion: Floats) -> None:
    state = _view(memory)
    off = position - state.position
    state.position[:] += _PULL * off
    state.velocity[:] += _PULL_SPEED * off
    same = 1.0 if (state.quaternion * quaternion).sum() >= 0.0 else -1.0
    pulled = state.quaternion + _PULL_TURN * (same * quaternion - state.quaternion)
    state.quaternion[:] = pulled / np.sqrt((pulled**2).sum())


@jit
def _angles(quaternion: Floats) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [deg]; a positive pitch is nose up."""
    rotation = matrix(quaternion)
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    pitch = math.asin(min(max(rotation[2, 0], -1.0), 1.0))
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)
