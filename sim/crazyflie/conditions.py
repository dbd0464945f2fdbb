"""Conditions of the drone that a scenario may change: damage, loads, wind, errors of sensors."""

from collections.abc import Mapping, Sequence

import numpy as np

from sim.arrays import Floats
from sim.conditions import Range
from sim.crazyflie.airframe import BLADE_M

MOTORS = range(1, 5)

CONDITIONS: Mapping[str, Range] = {
    **{f"m{motor}.cut_{blade}_mm": Range(0.0, 0.0, 15.0) for motor in MOTORS for blade in "ab"},
    **{f"m{motor}.tape_mg": Range(0.0, 0.0, 100.0) for motor in MOTORS},
    **{f"m{motor}.thrust": Range(1.0, 0.0, 1.5) for motor in MOTORS},  # relative to its usual one
    "payload.mass_g": Range(0.0, 0.0, 30.0),
    **{f"payload.{axis}_mm": Range(0.0, -60.0, 60.0) for axis in "xyz"},
    "string.mass_g": Range(0.0, 0.0, 30.0),
    "string.length_mm": Range(100.0, 10.0, 500.0),
    **{f"wind.{axis}": Range(0.0, -10.0, 10.0) for axis in "xyz"},  # added to the drawn [m/s]
    "wind.gust": Range(0.0, 0.0, 5.0),  # added to its standard deviation [m/s]
    "battery.charge": Range(0.0, -1.0, 1.0),  # added to the drawn share of its capacity
    "battery.resistance": Range(1.0, 0.1, 10.0),  # relative to the drawn
    **{f"gyro.bias_{axis}": Range(0.0, -5.0, 5.0) for axis in "xyz"},  # [rad/s]
    **{f"accel.bias_{axis}": Range(0.0, -20.0, 20.0) for axis in "xyz"},  # [m/s^2]
}
"""Conditions by name. Cuts are of either blade of a propeller; x points forward, y left, z up."""

# Assumptions, as no figures are published: the outer part of a blade has this density, and tape is
# stuck to one blade at this share of its length, where it spoils so much of its thrust.
_TIP_KG_M = 1.3e-3
_TAPE_AT = 0.6
_TAPE_LOSS_MG = 1.5e-3


def vector(conditions: Mapping[str, float], prefix: str) -> Floats:
    """Return the three components of a condition, such as those of ``wind.``."""
    return np.array([conditions[f"{prefix}{axis}"] for axis in "xyz"])


def rotors_of(
    conditions: Mapping[str, float], thrust: Sequence[float], imbalance: Sequence[float]
) -> Floats:
    """Return the properties of the rotors with their damage, as `airframe.wrench` takes them.

    The thrust of a blade grows with the third, its drag with the fourth power of its length.

    Parameters
    ----------
    conditions
        Value of each condition.
    thrust, imbalance
        Of each undamaged rotor: relative to the model, and unbalanced mass times radius [kg m].
    """
    cuts = [[conditions[f"m{n}.cut_{blade}_mm"] / 1e3 for blade in "ab"] for n in MOTORS]
    left = BLADE_M - np.array(cuts)
    tape_mg = np.array([conditions[f"m{n}.tape_mg"] for n in MOTORS])
    wear = np.array([conditions[f"m{n}.thrust"] for n in MOTORS])
    lift = ((left / BLADE_M) ** 3).mean(axis=1) * (1.0 - _TAPE_LOSS_MG * tape_mg)
    drag = ((left / BLADE_M) ** 4).mean(axis=1)
    uneven = _TIP_KG_M * (left[:, 0] ** 2 - left[:, 1] ** 2) / 2.0
    taped = tape_mg * 1e-6 * _TAPE_AT * BLADE_M
    return np.array([thrust * wear * lift, drag / lift, imbalance + np.abs(uneven) + taped])
