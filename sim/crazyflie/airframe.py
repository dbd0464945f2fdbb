"""Physics of the Crazyflie that MuJoCo does not have: motors, propellers, drag and battery.

Motor voltage to thrust is the cubic that Bitcraze measured for the propellers of 47 mm, and the
ratio of torque to thrust is that of the same firmware (``platform_defaults_cf2.h``). Drag and the
thrust coefficient are those of J. Förster, "System Identification of the Crazyflie 2.0 Nano
Quadrocopter" (ETH Zürich, 2015).
"""

import math

import numpy as np

from oracle_pipeline.bags.jit import jit
from sim.arrays import Floats

STEP_S = 1e-3
MASS_KG = 0.027
INERTIA = (2.3951e-5, 2.3951e-5, 3.2347e-5)  # about its axes [kg m^2]
ARM_M = 0.046 / math.sqrt(2.0)  # of the motors along both axes
BLADE_M = 0.0235
_ROTOR_HEIGHT_M = 0.01  # above the centre of mass
# Motors 1 to 4: front right, back right, back left, front left; 1 and 3 turn counter-clockwise.
_X, _Y = np.array([ARM_M, -ARM_M, -ARM_M, ARM_M]), np.array([-ARM_M, -ARM_M, ARM_M, ARM_M])
_TURN = np.array([-1.0, 1.0, -1.0, 1.0])  # of the torque on the frame

_THRUST = (-0.014830744918356092, 0.04724465241828281, -0.01847364358025878, 0.005960923942142)
_TORQUE = 0.005964552  # per thrust [m]
_KF = 2.88e-8  # thrust per square of the speed [N s^2/rad^2]
_DRAG = np.array([9.1785e-7, 9.1785e-7, 10.311e-7])  # per speed of rotors and air [kg/rad]
_MOTOR_S = 0.03  # time constant
_UNSTEADY_S = 0.05  # correlation time of unsteady thrust

CAPACITY_AS = 0.25 * 3600.0  # 250 mAh
_IDLE_A, _AMPERE = 0.15, 24.0  # current, and that per thrust^1.5; together 2 A in a hover
# Open-circuit voltage of a lithium-polymer cell, by the share of its charge.
_CHARGE = np.array([-1.0, 0.0, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0, 2.0])
_OPEN_V = np.array([2.5, 3.0, 3.45, 3.6, 3.7, 3.78, 3.87, 4.0, 4.08, 4.2, 4.2])


# Rows of the state of the rotors: voltage at the motor, which lags behind its command; phase [rad];
# unsteady share of the thrust.
VOLTS, PHASE, UNSTEADY = range(3)
# Rows of the properties of the rotors: thrust and torque per thrust, relative to the model, and
# unbalanced mass times its radius [kg m].
THRUST, TORQUE, IMBALANCE = range(3)


@jit
def wrench(
    quaternion: Floats, velocity: Floats, duty: Floats, state: Floats, rotors: Floats,
    battery: Floats, air: Floats, centre: Floats, draws: Floats, out: Floats,
) -> None:  # fmt: skip
    """Advance motors and battery by a step, and write what acts on the frame.

    Parameters
    ----------
    quaternion, velocity
        Of the frame: w, x, y, z, and in the world [m/s].
    duty : ndarray of shape (4,)
        Commands of the motors, from 0 to 1.
    state, rotors : ndarray of shape (3, 4)
        State, which changes, and properties of the rotors; rows as above.
    battery : ndarray of shape (4,)
        Charge as a share of the capacity and voltage at the poles, which change; charge in
        addition, and inner resistance [Ohm].
    air : ndarray of shape (4,)
        Velocity of the air in the world [m/s], and unsteady share of the thrust.
    centre : ndarray of shape (3,)
        Centre of mass in the frame [m].
    draws : ndarray of shape (4,)
        Normal draws, one for each rotor.
    out : ndarray of shape (6,)
        Force [N] and torque [N m] in the world.
    """
    force, torque = np.zeros(3), np.zeros(3)
    volts, phase = state[VOLTS], state[PHASE]
    kept = 1.0 - STEP_S / _UNSTEADY_S
    state[UNSTEADY] = kept * state[UNSTEADY] + math.sqrt(1.0 - kept * kept) * air[3] * draws
    speeds = current = 0.0
    for i in range(4):
        volts[i] += (duty[i] * battery[1] - volts[i]) * STEP_S / _MOTOR_S
        v = volts[i]
        sound = _THRUST[0] + v * (_THRUST[1] + v * (_THRUST[2] + v * _THRUST[3]))
        if v < 0.5 or sound < 0.0:
            continue
        thrust = sound * rotors[THRUST, i] * (1.0 + state[UNSTEADY, i])
        speed = math.sqrt(sound / _KF)
        speeds += speed
        current += _AMPERE * sound * math.sqrt(sound)
        phase[i] = (phase[i] + speed * STEP_S) % (2.0 * math.pi)
        shake = rotors[IMBALANCE, i] * speed * speed
        side, ahead = shake * math.sin(phase[i]), shake * math.cos(phase[i])
        force[0] += ahead
        force[1] += side
        force[2] += thrust
        torque[0] += _Y[i] * thrust - _ROTOR_HEIGHT_M * side
        torque[1] += -_X[i] * thrust + _ROTOR_HEIGHT_M * ahead
        torque[2] += _TURN[i] * _TORQUE * rotors[TORQUE, i] * thrust + _X[i] * side - _Y[i] * ahead
    battery[0] -= (_IDLE_A + current) * STEP_S / CAPACITY_AS
    open_v = np.interp(battery[0] + battery[2], _CHARGE, _OPEN_V)
    battery[1] = max(open_v - battery[3] * (_IDLE_A + current), 0.0)
    rotation = matrix(quaternion)
    force -= _DRAG * speeds * (rotation.T @ (velocity - air[:3]))
    torque -= np.cross(centre, force)  # MuJoCo applies the force at the centre of mass
    out[:3], out[3:] = rotation @ force, rotation @ torque


@jit
def matrix(quaternion: Floats) -> Floats:
    """Return the rotation matrix of a quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
