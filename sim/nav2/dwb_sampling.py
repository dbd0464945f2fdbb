"""The candidates of the DWB local planner: sampled velocities and their trajectories.

As ``dwb_plugins``' standard trajectory generator on Humble.
"""

import math
from typing import NamedTuple

import numpy as np

from oracle_pipeline.bags.jit import jit, jit_unchecked
from sim.arrays import Floats
from sim.middleware.geometry import Planar
from sim.nav2.paths import Poses

_EPSILON = 1e-5
STOCK_SIM_TIME = 1.7  # [s]


class Parameters(NamedTuple):
    """The Waffle's values in ``nav2_params.yaml``; names as there.

    Only ``sim_time`` is ours (there: `STOCK_SIM_TIME`); why is in docs/explanation/navigation.md.
    """

    max_vel_x: float = 0.26  # [m/s]; the robot never drives backwards
    max_vel_theta: float = 1.0  # [rad/s], to either side
    acc_lim_x: float = 2.5  # [m/s^2]
    decel_lim_x: float = -2.5  # [m/s^2]
    acc_lim_theta: float = 3.2  # [rad/s^2]
    decel_lim_theta: float = -3.2  # [rad/s^2]
    vx_samples: int = 20
    vtheta_samples: int = 20
    sim_time: float = 1.0  # [s]
    linear_granularity: float = 0.05  # [m]
    angular_granularity: float = 0.025  # [rad]
    prune_distance: float = 2.0  # of the plan kept behind the robot [m]
    forward_prune_distance: float = 2.0  # of the plan followed ahead of it [m]
    xy_goal_tolerance: float = 0.25  # [m]
    trans_stopped_velocity: float = 0.25  # [m/s]
    slowing_factor: float = 5.0
    forward_point_distance: float = 0.1  # [m]
    rotate_to_goal_scale: float = 32.0
    base_obstacle_scale: float = 0.02
    goal_align_scale: float = 24.0
    path_align_scale: float = 32.0
    path_dist_scale: float = 32.0
    goal_dist_scale: float = 24.0


class Start(NamedTuple):
    """What a rollout begins with."""

    parameters: Parameters
    pose: Planar
    velocity: tuple[float, float]  # forward [m/s], turning [rad/s]


@jit
def _approach(current: float, target: float, rise: float, fall: float) -> float:
    """Return the speed after changing towards ``target`` by at most ``rise`` or ``-fall``."""
    if current < target:
        return min(target, current + rise)
    return max(target, current + fall)


@jit
def samples(
    current: float, low: float, high: float, rise: float, fall: float, count: int
) -> Floats:
    """Return the speeds to try: evenly over what can be reached, and zero if it is between."""
    top, bottom = _approach(current, high, rise, fall), _approach(current, low, rise, fall)
    speeds = np.empty(count + 1)
    if abs(top - bottom) < _EPSILON:
        speeds[0] = bottom
        return speeds[:1]
    step = (top - bottom) / (count - 1)
    size = 0
    for i in range(count):
        speed = bottom + i * step
        if i > 0 and speeds[size - 1] < 0.0 < speed:
            speeds[size] = 0.0
            size += 1
        speeds[size] = speed
        size += 1
    return speeds[:size]


@jit
def twists(parameters: Parameters, velocity: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return the forward and the turning speeds to try; every pair but (0, 0) is a twist."""
    time = parameters.sim_time
    forward = samples(
        velocity[0], 0.0, parameters.max_vel_x, parameters.acc_lim_x * time,
        parameters.decel_lim_x * time, parameters.vx_samples,
    )  # fmt: skip
    turning = samples(
        velocity[1], -parameters.max_vel_theta, parameters.max_vel_theta,
        parameters.acc_lim_theta * time, parameters.decel_lim_theta * time,
        parameters.vtheta_samples,
    )  # fmt: skip
    return forward, turning


@jit
def step_count(parameters: Parameters, twist: tuple[float, float]) -> int:
    """Return in how many steps a velocity is rolled out."""
    linear = abs(twist[0]) * parameters.sim_time / parameters.linear_granularity
    angular = abs(twist[1]) * parameters.sim_time / parameters.angular_granularity
    return max(1, math.ceil(max(linear, angular)))


@jit
def most_poses(parameters: Parameters, forward: Floats, turning: Floats) -> int:
    """Return how many poses the longest rollout of ascending speeds has."""
    driving = step_count(parameters, (forward[-1], 0.0))
    left, right = (
        step_count(parameters, (0.0, turning[-1])),
        step_count(parameters, (0.0, turning[0])),
    )
    return max(driving, left, right) + 2


@jit
def roll(start: Start, twist: tuple[float, float], rollout: Poses) -> int:
    """Drive from ``start`` towards ``twist`` for ``sim_time``; return how many poses were written.

    The first is where the robot is, the last one is written twice (``include_last_point``).
    """
    parameters, (x, y, yaw), (v, w) = start
    steps = step_count(parameters, twist)
    dt = parameters.sim_time / steps
    heading_x, heading_y = math.cos(yaw), math.sin(yaw)
    turn_x, turn_y, turned = 1.0, 0.0, 0.0
    rollout[0, 0], rollout[0, 1], rollout[0, 2] = x, y, yaw
    for i in range(1, steps + 1):
        v = _approach(v, twist[0], parameters.acc_lim_x * dt, parameters.decel_lim_x * dt)
        w = _approach(w, twist[1], parameters.acc_lim_theta * dt, parameters.decel_lim_theta * dt)
        x += v * heading_x * dt
        y += v * heading_y * dt
        yaw += w * dt
        if w != turned:  # after speeding up it stays, and so does the rotation of a step
            turn_x, turn_y, turned = math.cos(w * dt), math.sin(w * dt), w
        heading_x, heading_y = (
            heading_x * turn_x - heading_y * turn_y,
            heading_y * turn_x + heading_x * turn_y,
        )
        rollout[i, 0], rollout[i, 1], rollout[i, 2] = x, y, yaw
    rollout[steps + 1, 0], rollout[steps + 1, 1], rollout[steps + 1, 2] = x, y, yaw
    return steps + 2


@jit
def headings(start: Start, target: float, count: int, way: Floats) -> tuple[float, float]:
    """Return the direction at the end of a rollout, and fill in where its steps lead.

    The directions are those of ``roll`` up to rounding; in as many steps, every forward speed has
    the same.

    Parameters
    ----------
    start
        Robot and parameters.
    target
        Turning speed that is rolled out [rad/s].
    count
        Steps.
    way
        Shape (more than ``count``, 4); row i gets where the first i steps lead, if their lengths
        are all 1, and if they are 1, 2, 3 and so on.
    """
    parameters, (_, _, yaw), (_, turning) = start
    w, dt = turning, parameters.sim_time / count
    rise, fall = parameters.acc_lim_theta * dt, parameters.decel_lim_theta * dt
    change = (rise if turning < target else fall) * dt  # from one step's angle to the next
    change_x, change_y = math.cos(change), math.sin(change)
    turn_x, turn_y = math.cos(turning * dt), math.sin(turning * dt)
    x, y = math.cos(yaw), math.sin(yaw)
    way[0] = 0.0
    for i in range(count):
        way[i + 1, 0], way[i + 1, 1] = way[i, 0] + x, way[i, 1] + y
        way[i + 1, 2], way[i + 1, 3] = way[i, 2] + (i + 1) * x, way[i, 3] + (i + 1) * y
        if i == 0 or w != target:
            w = _approach(w, target, rise, fall)
            turn_x, turn_y = (
                turn_x * change_x - turn_y * change_y,
                turn_y * change_x + turn_x * change_y,
            )
            if w == target:
                turn_x, turn_y = math.cos(w * dt), math.sin(w * dt)
        x, y = x * turn_x - y * turn_y, y * turn_x + x * turn_y
    return x, y


@jit_unchecked
def ends(
    start: Start,
    targets: Floats,
    count: int,
    way: Floats,
    ahead: tuple[float, float],
    points: Floats,
) -> None:
    """Find where rollouts end, up to the rounding of their sums.

    While a rollout speeds up, its steps grow evenly; then they have one length.

    Parameters
    ----------
    start, count, way
        As for ``headings``, which has filled ``way`` in.
    targets
        Forward speeds that are rolled out, shape (n,) [m/s].
    ahead
        From there to a point in front of the robot [m].
    points
        Shape (n, 4); gets x and y of the end and of that point [m].
    """
    parameters, place, (forward, _) = start
    dt = parameters.sim_time / count
    rise, fall = parameters.acc_lim_x * dt, parameters.decel_lim_x * dt
    end_x, end_y = way[count, 0], way[count, 1]
    for n in range(len(targets)):
        target = targets[n]
        change = rise if forward < target else fall
        i = min(int((target - forward) / change), count)  # steps until it has its speed
        x = forward * way[i, 0] + change * way[i, 2] + target * (end_x - way[i, 0])
        y = forward * way[i, 1] + change * way[i, 3] + target * (end_y - way[i, 1])
        x, y = place[0] + dt * x, place[1] + dt * y
        points[n, 0], points[n, 1] = x, y
        points[n, 2], points[n, 3] = x + ahead[0], y + ahead[1]


@jit
def last_yaw(start: Start, target: float, count: int) -> float:
    """Return the yaw at the end of a rollout, that of ``roll`` to the last bit [rad]."""
    parameters, (_, _, yaw), (_, turning) = start
    w, dt = turning, parameters.sim_time / count
    for _ in range(count):
        w = _approach(w, target, parameters.acc_lim_theta * dt, parameters.decel_lim_theta * dt)
        yaw += w * dt
    return yaw
