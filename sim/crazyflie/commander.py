"""The program that flies the Crazyflie: take-off, the legs of the flight, landing.

It streams full states as setpoints, as examples of Crazyswarm2 do. A leg has succeeded when a pose
near its end has arrived; else the flight ends with a landing, as it does when the battery is low or
the Crazyflie has tumbled.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

from oracle_pipeline.bags.types import message_class
from sim.crazyflie.recipes import Leg, Place
from sim.crazyflie.server import IS_TUMBLED
from sim.crazyflie.tracking import FRAME, NAME, pose_message
from sim.goal_progress import GoalProgress
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header

SETPOINT_NS = 20 * MILLISECOND
CLIMB_M_S = 0.4
NEAR_M, LATE_S = 0.15, 5.0  # of the end of a leg; a leg that is later has failed
CRITICAL_V, CRITICAL_REPORTS = 3.0, 3  # it lands if so many reports in a row are below

_FullState = message_class("crazyflie_interfaces/msg/FullState")
_Twist = message_class("geometry_msgs/msg/Twist")
_Vector3 = message_class("geometry_msgs/msg/Vector3")


def place(leg: Leg, before: Place, time_s: float) -> Place:
    """Return the setpoint of a leg at a time since it began.

    Parameters
    ----------
    leg
        The leg.
    before
        Where the leg before it ended.
    time_s
        Time since it began [s].
    """
    s = min(time_s / leg.seconds, 1.0)
    done = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)  # from rest to rest, with the least jerk
    if leg.kind == "eight":
        angle = 2.0 * math.pi * done
        ahead, aside = leg.size * math.sin(angle), leg.size / 2.0 * math.sin(2.0 * angle)
        return leg.x + ahead, leg.y + aside, leg.z, leg.yaw
    x, y, z, yaw = (a + done * (b - a) for a, b in zip(before, leg.end, strict=True))
    return x, y, z, yaw


class FlightCommander(Node):
    """Flies one flight.

    Parameters
    ----------
    domain, latency_ns
        As for `Node`.

    Attributes
    ----------
    results : list of GoalProgress
        Of the legs that were begun.
    is_over : bool
        Whether it has landed.
    """

    def __init__(self, domain: Domain, latency_ns: int) -> None:
        super().__init__(domain, "/flight_commander", endpoints="PE", latency_ns=latency_ns)
        self._full_state = self.create_publisher(
            "crazyflie_interfaces/msg/FullState", f"/{NAME}/cmd_full_state"
        )
        self.create_subscription("geometry_msgs/msg/PoseStamped", f"/{NAME}/pose", self._on_pose)
        status = "crazyflie_interfaces/msg/Status"
        self.create_subscription(status, f"/{NAME}/status", self._on_status)
        self.results: list[GoalProgress] = []
        self.is_over = False
        self._here = (0.0, 0.0, 0.0)  # the last pose that arrived
        self._critical = 0  # reports in a row
        self._trouble = ""  # why it has to land
        self._before = self._wanted = (0.0, 0.0, 0.0, 0.0)

    def fly(self, legs: Sequence[Leg], on_leg: Callable[[int], None]) -> None:
        """Take off, fly the legs, and land.

        Parameters
        ----------
        legs
            At least one.
        on_leg
            Called with the number of each leg, from 1, when it begins.
        """
        self._legs, self._on_leg = iter(legs), on_leg
        x, y, z, yaw = legs[0].end
        self._begin(Leg("takeoff", x, y, z, yaw, z / CLIMB_M_S))
        self._timer = self.create_timer(SETPOINT_NS, self._update)
        self.info("Taking off")

    def _begin(self, leg: Leg) -> None:
        self._leg, self._begun_ns = leg, self.now_ns

    def _update(self) -> None:
        """Send the next setpoint; begin the next leg at the end of one."""
        leg, time_s = self._leg, (self.now_ns - self._begun_ns) / SECOND
        wanted = self._wanted = place(leg, self._before, time_s)
        self._send(wanted, place(leg, self._before, time_s + SETPOINT_NS / SECOND))
        is_over, lands = time_s >= leg.seconds, leg.kind == "landing"
        if lands and is_over:
            self._timer.cancel()
            self.info("Landed")
            self.is_over = True
        elif self._trouble and not lands:
            self._end("aborted")
        elif is_over and math.dist(self._here, wanted[:3]) <= NEAR_M:
            self._end("succeeded")
        elif time_s >= leg.seconds + LATE_S:
            self._trouble = f"{NAME} is not where it should be"

    def _end(self, outcome: Literal["succeeded", "aborted"]) -> None:
        """End this leg, and begin the next or the landing."""
        self._before = x, y, z, yaw = self._wanted
        if self.results:
            self.results[-1].end(self.now_ns, outcome)
            self.info(f"Leg {len(self.results)} {outcome}")
        leg = None if self._trouble else next(self._legs, None)
        if leg is None:
            self.info(f"Landing. {self._trouble}")
            self._begin(Leg("landing", x, y, 0.0, yaw, z / CLIMB_M_S + 1.0))
            return
        self._begin(leg)
        self.results.append(GoalProgress(self.now_ns))
        self._on_leg(len(self.results))

    def _send(self, wanted: Place, ahead: Place) -> None:
        """Send a setpoint, whose speed is that to the next one."""
        x, y, z, yaw = wanted
        still = _Vector3(0.0, 0.0, 0.0)
        speed = _Vector3(
            *((b - a) * SECOND / SETPOINT_NS for a, b in zip(wanted[:3], ahead[:3], strict=True))
        )
        pose = pose_message((x, y, z), (math.cos(yaw / 2.0), 0.0, 0.0, math.sin(yaw / 2.0)))
        twist = _Twist(speed, still)
        self._full_state.publish(_FullState(header(self.now_ns, FRAME), pose, twist, still))

    def _on_pose(self, message: Any) -> None:
        at = message.pose.position
        self._here = (at.x, at.y, at.z)

    def _on_status(self, status: Any) -> None:
        is_critical = status.battery_voltage < CRITICAL_V
        self._critical = self._critical + 1 if is_critical else 0
        if self._critical >= CRITICAL_REPORTS:
            self._trouble = f"the battery has {status.battery_voltage:.2f} V"
        elif status.supervisor_info & IS_TUMBLED:
            self._trouble = f"{NAME} has tumbled"
