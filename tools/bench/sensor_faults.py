"""How often ``oracle score`` exits 1 for a faulty joint sensor of robots of Gymnasium's models.

Models of other people: legs and a swimmer that move by oscillators, and arms that reach for
targets, each recording in its own way. Rate errors were devised on the first four; the others are
held out. They log position, velocity and command of each joint at 50 Hz as CSV. A card of 29 normal
recordings judges others. In faulty ones, one joint's sensor is off, noisy, badly scaled or stuck,
from a third of the recording on; the robot is controlled by what it tells.
Needs ``pip install --no-deps gymnasium``.
"""

import importlib.util
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline import ReferenceCard, learn, score
from oracle_pipeline.scoring.output import exit_code
from tools.bench.figures import Row

LEARNED, JUDGED = 29, 10
FAR = 0.1
SEED = 3
HZ, DURATION_S = 50, 20.0
DEVISED = ("half_cheetah", "ant", "swimmer", "pusher")
HELD_OUT = ("walker2d", "hopper", "reacher", "humanoid")
ARMS = ("pusher", "reacher")  # the others are driven by oscillators
OFFSET_RAD, NOISE_RAD, SCALE, STUCK_S, EVERY_S = 0.08, 0.02, 1.2, 1.0, 4.0
FAULTS = ("offset", "noise", "scale", "stuck")

Floats: TypeAlias = NDArray[np.float64]
Control: TypeAlias = Callable[[float, Floats, Floats], Floats]  # of time [s], positions and rates


def rows() -> Iterator[Row]:
    """Yield how many recordings of each robot and fault are called."""
    with tempfile.TemporaryDirectory() as folder:
        for robot in (*DEVISED, *HELD_OUT):
            root = Path(folder) / robot
            root.mkdir()
            good = [_recorded(robot, root, SEED + n) for n in range(LEARNED)]
            yield from _rows(robot, root, learn(good))


def _rows(robot: str, root: Path, card: ReferenceCard) -> Iterator[Row]:
    for number, fault in enumerate(("", *FAULTS), start=1):
        seeds = range(SEED + 1000 * number, SEED + 1000 * number + JUDGED)
        tried = [_recorded(robot, root, seed, fault) for seed in seeds]
        called = sum(exit_code([each]) for each in score(tried, card, far=FAR))
        yield Row(f"{robot}, {fault or 'normal'}: called", called, f"of {JUDGED}")


def _recorded(robot: str, root: Path, seed: int, fault: str = "") -> Path:
    """Simulate a recording, and return its CSV."""
    path = root / f"{fault or 'normal'}_{seed}.csv"
    _simulated(robot, np.random.default_rng(seed), fault).to_csv(path, index=False)
    return path


def _simulated(robot: str, rng: np.random.Generator, fault: str) -> pd.DataFrame:
    model, count = _model(robot)
    data = mujoco.MjData(model)
    joints = slice(0, model.nu) if robot in ARMS else slice(model.nq - model.nu, None)
    rates = slice(0, model.nu) if robot in ARMS else slice(model.nv - model.nu, None)
    control = _reaching(model.nu, rng) if robot in ARMS else _oscillating(model.nu, rng)
    sensors = _Sensors(int(rng.integers(model.nu)), fault, rng)
    told = []
    for time_s in np.arange(0.0, DURATION_S, 1.0 / HZ).tolist():
        position, velocity = sensors.read(time_s, data.qpos[joints], data.qvel[rates])
        command = control(time_s, position, velocity)
        data.ctrl[:] = np.clip(command, *model.actuator_ctrlrange.T)
        mujoco.mj_step(model, data, count)
        told.append([time_s, *position, *velocity, *command])
    fields = ("joint_states.position", "joint_states.velocity", "command.effort")
    names = [f"{field}[{joint}]" for field in fields for joint in range(model.nu)]
    return pd.DataFrame(told, columns=["time", *names])


def _model(robot: str) -> tuple[mujoco.MjModel, int]:
    """Return a model of Gymnasium, and its steps for each row."""
    package = importlib.util.find_spec("gymnasium")
    if package is None or not package.submodule_search_locations:
        raise RuntimeError("This needs Gymnasium's models: pip install --no-deps gymnasium")
    assets = Path(package.submodule_search_locations[0], "envs", "mujoco", "assets")
    model = mujoco.MjModel.from_xml_path(str(assets / f"{robot}.xml"))
    count = max(1, round(1.0 / HZ / model.opt.timestep))
    model.opt.timestep = 1.0 / HZ / count
    return model, count


def _oscillating(joints: int, rng: np.random.Generator) -> Control:
    """Return a control that swings all joints, at a rate that wanders."""
    usual_hz, size = rng.uniform(0.8, 1.6), rng.uniform(0.5, 0.9)
    phase, pace = np.arange(joints) * rng.uniform(1.0, 1.4), 1.0

    def control(_time_s: float, _position: Floats, _velocity: Floats) -> Floats:
        nonlocal phase, pace
        pace += 0.02 * (1.0 - pace) + 0.02 * rng.normal()
        phase = phase + 2.0 * np.pi * usual_hz * max(0.3, pace) / HZ
        return np.asarray(size * np.sin(phase))

    return control


def _reaching(joints: int, rng: np.random.Generator) -> Control:
    """Return a control that reaches for one target after the other."""
    target, until_s = np.zeros(joints), 0.0

    def control(time_s: float, position: Floats, velocity: Floats) -> Floats:
        nonlocal target, until_s
        if time_s >= until_s:
            target, until_s = rng.uniform(-0.8, 0.8, joints), time_s + rng.uniform(1.5, 3.0)
        return np.asarray(4.0 * (target - position) - 0.4 * velocity)

    return control


class _Sensors:
    """Noisy sensors of all joints, one of which may have a fault from a third on."""

    def __init__(self, joint: int, fault: str, rng: np.random.Generator) -> None:
        self._joint, self._fault, self._rng = joint, fault, rng
        self._held: tuple[float, float] | None = None

    def read(self, time_s: float, position: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Return what they tell of positions [rad] and velocities [rad/s]."""
        position = position + self._rng.normal(0.0, 0.002, position.shape)
        velocity = velocity + self._rng.normal(0.0, 0.02, velocity.shape)
        if time_s < DURATION_S / 3.0:
            return position, velocity
        joint = self._joint
        if self._fault == "offset":
            position[joint] += OFFSET_RAD
        elif self._fault == "noise":
            position[joint] += self._rng.normal(0.0, NOISE_RAD)
        elif self._fault == "scale":
            velocity[joint] *= SCALE
        elif self._fault == "stuck" and time_s % EVERY_S < STUCK_S:
            self._held = self._held or (position[joint], velocity[joint])
            position[joint], velocity[joint] = self._held
        else:
            self._held = None
        return position, velocity
