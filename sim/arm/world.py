"""The physics: the cell in MuJoCo, and measurements of its sensors.

No other module uses ``MjModel`` or ``MjData``. The servos of the joints follow setpoints, as those
of Universal Robots do.
"""

import math

import mujoco
import numpy as np

from sim.arm.cell import CELL, FINGER_M, HOME, OBJECT_M
from sim.arm.conditions import BIASES, CONDITIONS, of_joints
from sim.arm.recipes import ArmRecipe
from sim.arrays import Floats

STEP_S, STEP_NS = 2e-3, 2_000_000  # as of the controller of the UR5e, which runs at 500 Hz
GRIP_N = 20.0  # of each finger
_QPOS, _QVEL = 7, 6  # where the joints of the arm begin, after the object's
_WEIGHT_N, _TILT_NM = 9.81 * 0.9, 9.81 * 0.055  # of the gripper; about the flange if it is level
_NOISE = (2e-5, 1e-3, 0.05)  # standard deviations of a joint's [rad, rad/s, N m]
_EPISODE_NS = 1_000_000_000  # what touches a thing touches it again and again


class World:
    """A cell with an arm.

    Parameters
    ----------
    recipe
        Of the run.
    rng
        Draws the noise of the sensors.

    Attributes
    ----------
    touched : list of (int, str)
        When the arm began to touch the table or the post, and which.
    """

    def __init__(self, recipe: ArmRecipe, rng: np.random.Generator) -> None:
        self._session, self._rng = recipe.session, rng
        self._model = model = mujoco.MjModel.from_xml_path(str(CELL))
        self._data = data = mujoco.MjData(model)
        data.qpos[_QPOS:] = [*HOME, FINGER_M, FINGER_M]
        start, model.geom("post").pos[:2] = recipe.start, (recipe.obstacle.x, recipe.obstacle.y)
        data.joint("object").qpos[:3] = start.x, start.y, OBJECT_M[2]
        data.joint("object").qpos[3::3] = math.cos(start.yaw / 2.0), math.sin(start.yaw / 2.0)
        self._used = model.actuator_gainprm, model.actuator_biasprm
        self._gains = [used.copy() for used in self._used]
        self._object, self._tool = data.body("object"), data.site("sensor")
        self._still = {model.geom(name).id: name for name in ("table", "post")}
        self._thing = model.geom("object").id
        force = recipe.session.force_n, recipe.session.torque_nm
        self._noise_sd = np.repeat([*_NOISE, *force], (7, 7, 7, 3, 3))
        self._setpoint, self._speed, self._since = np.array(HOME), np.zeros(6), 0
        self._lead = model.actuator_biasprm[:6, 2] / model.actuator_biasprm[:6, 1]
        self._steps, self._effort = 0, GRIP_N
        self.touched: list[tuple[int, str]] = []
        self._conditions = {name: values.usual for name, values in CONDITIONS.items()}
        self._apply()
        self.grip(FINGER_M, GRIP_N)
        mujoco.mj_forward(model, data)

    def measure(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return positions, velocities and efforts of the joints and a finger, and the wrench.

        The wrench is what the tool exerts on the flange in tool0, without the tool's weight: force
        [N] and torque [N m].
        """
        data = self._data
        draws = self._noise_sd * self._rng.standard_normal(len(self._noise_sd))
        positions = data.qpos[_QPOS:-1] + draws[:7]
        positions[:6] += self._encoder
        down = self._tool.xmat[6:]  # the world's z axis in tool0
        wrench = self._bias - data.sensordata + draws[21:]
        wrench[:3] += _WEIGHT_N * down
        wrench[3:5] += _TILT_NM * np.array([-down[1], down[0]])
        speeds = data.qvel[_QVEL:-1] + draws[7:14]
        return positions, speeds, data.qfrc_actuator[_QVEL:-1] + draws[14:21], wrench

    def object_pose(self) -> tuple[Floats, Floats]:
        """Return the ground truth of the object: position [m], and quaternion w, x, y, z."""
        return np.array(self._object.xpos), np.array(self._object.xquat)

    def tool(self) -> Floats:
        """Return the ground truth of the tool's place [m]."""
        return np.array(self._tool.xpos)

    def command(self, positions: Floats, speeds: Floats) -> None:
        """Give the servos a setpoint that moves on with a speed [rad/s]."""
        self._setpoint, self._speed, self._since = positions, speeds, self._steps

    def grip(self, position: float, effort: float) -> None:
        """Move each finger to a position [m], with a force of at most an effort [N]."""
        self._data.ctrl[6:] = position
        self._effort = effort
        self._apply_grip()

    def change(self, condition: str, value: float) -> None:
        """Change a condition from now on."""
        self._conditions[condition] = value
        self._apply()

    def advance_to(self, time_ns: int) -> None:
        """Take every step that is due by ``time_ns``."""
        model, data = self._model, self._data
        while (self._steps + 1) * STEP_NS <= time_ns:
            ahead = (self._steps - self._since) * STEP_S + self._lead
            data.ctrl[:6] = self._setpoint - self._encoder + ahead * self._speed
            mujoco.mj_step(model, data)
            self._steps += 1
            if data.ncon > 4:  # it stands on four corners
                self._look()

    def _look(self) -> None:
        """Note what the arm touches."""
        now_ns = self._steps * STEP_NS
        for pair in self._data.contact.geom.tolist():
            if self._thing not in pair and any(geom in self._still for geom in pair):
                hit = next(self._still[geom] for geom in pair if geom in self._still)
                if not any(name == hit and now_ns - at < _EPISODE_NS for at, name in self.touched):
                    self.touched.append((now_ns, hit))

    def _apply(self) -> None:
        """Compute what follows from the conditions."""
        now, drawn, model = self._conditions, self._session, self._model
        for kept, used in zip(self._gains, self._used, strict=True):
            used[:6] = kept[:6] * drawn.gains * now["servo.gains"]
        self._encoder = np.array(drawn.encoder) + of_joints(now, "encoder.")
        rub = np.array(drawn.joint_friction) + of_joints(now, "friction.")
        model.dof_frictionloss[_QVEL : _QVEL + len(rub)] = np.maximum(rub, 0.0)
        for pad in ("left_pad", "right_pad"):
            model.geom(pad).friction[0] = drawn.friction * now["gripper.friction"]
        heavier = max(drawn.mass + now["object.mass_kg"], 0.01)
        thing, payload = model.body("object"), model.body("payload")
        thing.inertia[:] *= heavier / thing.mass[0]
        thing.mass[:] = heavier
        payload.mass[:] = 1e-6 + now["payload.mass_kg"]
        self._bias = np.array([now[name] for name in BIASES])
        self._apply_grip()
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def _apply_grip(self) -> None:
        force = self._effort * self._conditions["gripper.force"]
        self._model.actuator_forcerange[6:] = -force, force
