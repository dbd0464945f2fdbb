"""The physics: room and Crazyflie in MuJoCo, and exact measurements of its sensors.

No other module uses ``MjModel`` or ``MjData``. Mass and inertia are those of the model
``bitcraze_crazyflie_2`` of MuJoCo Menagerie (MIT licence); its geometry here is a box. The world's
frame has its origin on the floor, x forward, y left and z up.
"""

from collections.abc import Callable

import mujoco
import numpy as np

from sim.arrays import Floats
from sim.crazyflie.airframe import INERTIA, MASS_KG, STEP_S, wrench
from sim.crazyflie.conditions import CONDITIONS, rotors_of, vector
from sim.crazyflie.recipes import Craft

STEP_NS = round(STEP_S * 1e9)
START_Z = 0.015  # of the frame on the floor [m]
_GUST_S = 1.0  # correlation time of gusts
_NOISE = np.repeat([0.004, 0.05], 3)  # standard deviation of a sample [rad/s, m/s^2]
_AHEAD = 512  # steps for which noise is drawn at once
_EPISODE_NS = 1_000_000_000  # a frame that tumbles over the floor touches it again and again
_HARD_M_S = 1.5  # speed at which a touch is no landing

_MJCF = f"""
<mujoco>
  <option timestep="{STEP_S}" gravity="0 0 -9.81">
    <flag island="disable" midphase="disable" frictionloss="disable" limit="disable"/>
  </option>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body name="frame" pos="0 0 {START_Z}">
      <freejoint/>
      <inertial pos="{{x}} {{y}} 0" mass="{{mass}}" diaginertia="{{inertia}}"/>
      <geom type="box" size="0.045 0.045 {START_Z}"/>
      <site name="imu"/>
      <body name="payload"><inertial pos="0 0 0" mass="1" diaginertia="1e-13 1e-13 1e-13"/></body>
      <body name="string"><joint type="ball" damping="1e-6"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1e-10 1e-10 1e-10"/></body>
    </body>
  </worldbody>
  <sensor><gyro site="imu"/><accelerometer site="imu"/></sensor>
</mujoco>
"""


class World:
    """A room with a Crazyflie.

    Parameters
    ----------
    craft
        The Crazyflie, its battery and the wind.
    autopilot
        Takes a sample of the inertial unit each millisecond: angular velocity [rad/s] and specific
        force [m/s^2], shape (6,). Returns the commands of the motors, from 0 to 1, shape (4,).
    rng
        Draws gusts and the noise of the inertial unit.

    Attributes
    ----------
    hits_ns : list of int
        When the frame hit the floor, faster than in a landing.
    """

    def __init__(
        self, craft: Craft, autopilot: Callable[[Floats], Floats], rng: np.random.Generator
    ) -> None:
        x, y = craft.centre
        inertia = " ".join(str(craft.mass * value) for value in INERTIA)
        text = _MJCF.format(x=x, y=y, mass=craft.mass * MASS_KG, inertia=inertia)
        self._model = mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)
        self._craft, self._autopilot, self._rng = craft, autopilot, rng
        self._rotor_state = np.zeros((3, 4))
        self._battery = np.array([craft.charge, 0.0, 0.0, craft.resistance])
        self._air = np.array([0.0, 0.0, 0.0, craft.unsteady])
        self._centre = np.array([*craft.centre, 0.0])
        data = self._data  # of which these are views
        self._quaternion, self._velocity = data.qpos[3:7], data.qvel[:3]
        self._wrench = data.xfrc_applied[self._model.body("frame").id]
        self._sensors = data.sensordata
        self._duty = np.zeros(4)
        self._gust = np.zeros(3)
        self._noise = np.zeros((0, 13))
        self._steps = 0
        self.hits_ns: list[int] = []
        self._conditions = {name: values.usual for name, values in CONDITIONS.items()}
        self._apply()

    def pose(self) -> tuple[Floats, Floats]:
        """Return the ground truth of the frame: position [m], and quaternion w, x, y, z."""
        return self._data.qpos[:3].copy(), self._quaternion.copy()

    def volts(self) -> float:
        """Return the voltage of the battery."""
        return float(self._battery[1])

    def change(self, condition: str, value: float) -> None:
        """Change a condition from now on."""
        self._conditions[condition] = value
        self._apply()

    def advance_to(self, time_ns: int) -> None:
        """Take every step that is due by ``time_ns``."""
        while (self._steps + 1) * STEP_NS <= time_ns:
            self._step()

    def _apply(self) -> None:
        """Compute what follows from the conditions."""
        now, craft, model = self._conditions, self._craft, self._model
        self._rotors = rotors_of(now, craft.thrust, craft.imbalance)
        self._wind = vector(now, "wind.") + np.array([*craft.wind, 0.0])
        self._gust_sd = craft.gust + now["wind.gust"]
        self._battery[2] = now["battery.charge"]
        self._battery[3] = craft.resistance * now["battery.resistance"]
        self._bias = np.concatenate([vector(now, "gyro.bias_"), vector(now, "accel.bias_")])
        payload, string = model.body("payload").id, model.body("string").id
        model.body_mass[payload] = 1e-9 + now["payload.mass_g"] / 1e3
        model.body_ipos[payload] = [now[f"payload.{axis}_mm"] / 1e3 for axis in "xyz"]
        model.body_mass[string] = 1e-6 + now["string.mass_g"] / 1e3
        model.body_ipos[string, 2] = -now["string.length_mm"] / 1e3
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def _step(self) -> None:
        """Take a step, and give the autopilot its sample."""
        model, data = self._model, self._data
        row = self._steps % _AHEAD
        if row == 0:
            self._noise = self._rng.standard_normal((_AHEAD, 13))
        draws = self._noise[row]
        kept = 1.0 - STEP_S / _GUST_S
        self._gust = kept * self._gust + (1.0 - kept**2) ** 0.5 * self._gust_sd * draws[:3]
        self._air[:3] = self._wind + self._gust
        wrench(
            self._quaternion, self._velocity, self._duty, self._rotor_state, self._rotors,
            self._battery, self._air, self._centre, draws[9:], self._wrench,
        )  # fmt: skip
        mujoco.mj_step(model, data)
        self._steps += 1
        self._duty = self._autopilot(self._sensors + self._bias + draws[3:9] * _NOISE)
        hit_ns = self._steps * STEP_NS
        is_hard = data.ncon and self._velocity @ self._velocity > _HARD_M_S**2
        if is_hard and (not self.hits_ns or hit_ns - self.hits_ns[-1] > _EPISODE_NS):
            self.hits_ns.append(hit_ns)
