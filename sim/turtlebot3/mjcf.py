"""The world's pieces and the Waffle as MJCF, MuJoCo's format.

Masses and sizes of the robot are those of Nav2's Humble ``waffle.model``. ``arena`` has the
positions of the pieces of the world.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import starmap

from sim.middleware.geometry import Pose2D
from sim.turtlebot3.arena import HEXAGON, RING_THICKNESS, Arena, Box, Cylinder, Hexagon, Prism
from sim.turtlebot3.pedestrian import PERSON, Walk

STEP_NS = 5_000_000

WHEEL_RADIUS_M = 0.033
WHEEL_SEPARATION_M = 0.287  # as in the diff drive's settings; in the model's geometry it is 0.288
MAX_WHEEL_TORQUE_NM = 20.0
WALL_THICKNESS = 0.15  # of the walls around a drawn arena [m]
# A stiffer motor would reach its set-point within one step, and kick the robot off the floor.
_MOTOR_GAIN = 0.2  # [N m s/rad]

AROUND, ROBOT, FLOOR = 0, 1, 2  # geom groups
# A wheel touches the floor at one point, as a sphere does: the two edges of a cylinder would slip
# against each other in every turn. The cylinder touches the pieces of the world.
_TREAD_BIT = 2


@dataclass(frozen=True, slots=True)
class WorldParameters:
    """Parameters of the world that differ between runs."""

    start: Pose2D  # of base_footprint in the world
    friction: float = 1.0  # of the floor, relative to the model
    mass: float = 1.0  # of the robot, relative to the model
    obstacles: Sequence[Cylinder] = ()  # real ones that are on no map
    wheels: tuple[float, float] = (1.0, 1.0)  # radius of left and right, relative to the model
    arena: Arena = HEXAGON
    walk: Walk | None = None  # of a person

    @property
    def unmapped(self) -> tuple[Cylinder, ...]:
        """The pieces that are on no map; a person, the only one that moves, is the last."""
        return (*self.obstacles, PERSON) if self.walk else tuple(self.obstacles)


def pieces(parameters: WorldParameters) -> dict[str, str]:
    """Return name -> geoms of every piece of the world, those that are on no map last."""
    arena = parameters.arena
    return {
        **{block.name: _block(block) for block in arena.blocks},
        arena.boundary.name: _wall_around(arena.boundary),
        **{c.name: _cylinder(c) for c in (*arena.pillars, *parameters.unmapped)},
    }


def mjcf(parameters: WorldParameters, *, with_pieces: bool = True) -> str:
    """Return the model; without the pieces it is an infinite floor with the robot.

    The solver's islands and the tree of geoms are off: for a single robot they find the same
    contacts and forces, and take a seventh of the time of a step. So are the parts of the physics
    that the model does not use.
    """
    around = pieces(parameters) if with_pieces else {}
    return f"""
<mujoco>
  <option timestep="{STEP_NS / 1e9}" gravity="0 0 -9.8" integrator="implicitfast">
    <flag island="disable" midphase="disable" equality="disable" frictionloss="disable"
          limit="disable" spring="disable" damper="disable"/>
  </option>
  <default>
    <geom friction="{parameters.friction} 0.005 0.0001"/>
    <default class="robot"><geom group="{ROBOT}"/></default>
    <default class="on_floor">
      <geom group="{ROBOT}" contype="{_TREAD_BIT}" conaffinity="{_TREAD_BIT}"/>
    </default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="50 50 1" group="{FLOOR}"
          contype="{_TREAD_BIT}" conaffinity="{_TREAD_BIT}"/>
    {"".join(starmap(_piece, around.items()))}
    <body name="base_footprint">
      <freejoint/>
      <geom class="robot" type="box" size="0.1325 0.1325 0.0445" pos="-0.064 0 0.048"
            mass="{1.0 * parameters.mass}"/>
      <geom class="robot" type="cylinder" size="0.0508 0.0275" pos="-0.052 0 0.111"
            mass="{0.125 * parameters.mass}"/>
      <geom class="robot" type="box" size="0.004 0.065 0.011" pos="0.069 0 0.107"
            mass="{0.035 * parameters.mass}"/>
      <geom class="on_floor" type="sphere" size="0.005" pos="-0.177 0.064 -0.004" mass="0.001"
            condim="1" priority="1"/>
      <geom class="on_floor" type="sphere" size="0.005" pos="-0.177 -0.064 -0.004" mass="0.001"
            condim="1" priority="1"/>
      <site name="imu_link" pos="0 0 0.068"/>
      {_wheel("wheel_left", 0.144, parameters.wheels[0])}
      {_wheel("wheel_right", -0.144, parameters.wheels[1])}
    </body>
  </worldbody>
  <actuator>
    {_motor("wheel_left")}
    {_motor("wheel_right")}
  </actuator>
  <sensor>
    <gyro site="imu_link"/>
    <accelerometer site="imu_link"/>
    {"".join(map(_touch_sensor, around))}
  </sensor>
</mujoco>"""


def _piece(name: str, geoms: str) -> str:
    moves = ' mocap="true"' if name == PERSON.name else ""
    return f'<body name="{name}"{moves}>{geoms}</body>'


def _wheel(name: str, y: float, size: float) -> str:
    radius = size * WHEEL_RADIUS_M
    return f"""
      <body name="{name}" pos="0 {y} 0.023">
        <inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
        <joint name="{name}" axis="0 1 0"/>
        <geom class="robot" type="cylinder" size="{radius} 0.009" euler="90 0 0"/>
        <geom class="on_floor" type="sphere" size="{radius}" mass="0"/>
      </body>"""


def _motor(joint: str) -> str:
    limit = MAX_WHEEL_TORQUE_NM
    return f'<velocity joint="{joint}" kv="{_MOTOR_GAIN}" forcerange="-{limit} {limit}"/>'


def _touch_sensor(piece: str) -> str:
    return f'<contact subtree1="base_footprint" body2="{piece}" data="found"/>'


def _block(block: Prism) -> str:
    """Return a box, or a hexagon: the union of the three boxes that join its opposite sides."""
    if isinstance(block, Box):
        half = (block.half_x, block.half_y, block.height / 2.0)
        return _box(block.name, block.x, block.y, half[2], half, math.degrees(block.yaw))
    half = (block.apothem, block.circumradius / 2.0, (block.z_max - block.z_min) / 2.0)
    return "".join(
        _box(f"{block.name}#{i}", block.x, block.y, block.z_min + half[2], half, 30 + 60 * i)
        for i in range(3)
    )


def _wall_around(boundary: Prism) -> str:
    """Return walls behind the inner faces, long enough to close the corners."""
    if isinstance(boundary, Box):
        return _four_walls(boundary)
    return _ring(boundary)


def _four_walls(room: Box) -> str:
    thick, height = WALL_THICKNESS / 2.0, room.height / 2.0
    sides = (room.half_x + thick, room.half_y + thick)
    walls = []
    for i in range(4):
        axis, sign = i % 2, 1 - i // 2 * 2
        half = (thick, sides[1] + thick) if axis == 0 else (sides[0] + thick, thick)
        x, y = (
            (room.x + sign * sides[0], room.y) if axis == 0 else (room.x, room.y + sign * sides[1])
        )
        walls.append(_box(f"{room.name}#{i}", x, y, height, (*half, height), 0.0))
    return "".join(walls)


def _ring(ring: Hexagon) -> str:
    height = (ring.z_max - ring.z_min) / 2.0
    half = (RING_THICKNESS / 2.0, ring.circumradius * 9.0 / 16.0, height)
    distance = ring.apothem + half[0]
    walls = []
    for i in range(6):
        degrees = 30 + 60 * i
        x, y = (distance * f(math.radians(degrees)) for f in (math.cos, math.sin))
        walls.append(_box(f"{ring.name}#{i}", x, y, ring.z_min + height, half, degrees))
    return "".join(walls)


def _box(
    name: str, x: float, y: float, z: float, half: tuple[float, float, float], degrees: float
) -> str:
    size = " ".join(map(str, half))
    return (
        f'<geom name="{name}" type="box" pos="{x} {y} {z}" size="{size}" '
        f'euler="0 0 {degrees}" group="{AROUND}"/>'
    )


def _cylinder(c: Cylinder) -> str:
    half = c.height / 2.0
    return (
        f'<geom name="{c.name}" type="cylinder" pos="{c.x} {c.y} {half}" '
        f'size="{c.radius} {half}" group="{AROUND}"/>'
    )
