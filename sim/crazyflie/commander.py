"""The program that flies the Crazyflie: take-off, the legs of the flight, landing.

It streams full states as setpoints, as examples of Crazyswarm2 do. A leg has succeeded when a pose
near its end has arrived; else the flight ends with a landing, as it does when the battery is low or
the Crazyflie has tumbled.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from oracle_pipeline.bags.types import message_class
from sim.crazyflie.recipes import Leg
from sim.crazyflie.server import IS_TUMBLED
from sim.crazyflie.tracking import FRAME, NAME
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header

COMMANDER = "/flight_commander"
SETPOINT_NS = 20 * MILLISECOND
CLIMB_M_S = 0.4
NEAR_M = 0.15  # of the end of a leg
LATE_S = 5.0  # after which a leg has failed
CRITICAL_V = 3.0  # at which it lands, if so many reports in a row have it
CRITICAL_REPORTS = 3

_FullState = message_class("crazyflie_interfaces/msg/FullState")
_Point = message_class("geometry_msgs/msg/Point")
_Pose = message_class("geometry_msgs/msg/Pose")
_Quaternion = message_class("geometry_msgs/msg/Quaternion")
_Twist = message_class("geometry_msgs/msg/Twist")
_Vector3 = message_class("geometry_msgs/msg/Vector3")

_Place = tuple[float, float, float, float]  # x, y, z [m], yaw [rad]


@dataclass(slots=True)
class LegProgress:
    """How far a leg has come."""

    accepted_ns: int
    ended_ns: int | None = None
    outcome: Literal["succeeded", "aborted"] | None = None


def smooth(share: float) -> float:
    """Return how much of a way is done after a share of the time, from rest to rest."""
    s = min(max(share, 0.0), 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def place(leg: Leg, before: _Place, time_s: float) -> _Place:
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
    done = smooth(time_s / leg.seconds)
    if leg.kind == "eight":
        angle = 2.0 * math.pi * done
        return (leg.x + leg.size * math.sin(angle), leg.y + leg.size / 2.0 * math.sin(2.0 * angle),
                leg.z, leg.yaw)  # fmt: skip
    to = (leg.x, leg.y, leg.z, leg.yaw)
    x, y, z, yaw = (a + done * (b - a) for a, b in zip(before, to, strict=True))
    return x, y, z, yaw


class FlightCommander(Node):
    """Flies one flight.

    Parameters
    ----------
    domain, latency_ns
        As for `Node`.

    Attributes
    ----------
    results : list of LegProgress
        Of the legs that were begun.
    """

    def __init__(self, domain: Domain, latency_ns: int) -> None:
        super().__init__(domain, COMMANDER, latency_ns=latency_ns)
        self._full_state = self.create_publisher(
            "crazyflie_interfaces/msg/FullState", f"/{NAME}/cmd_full_state"
        )
        self.create_subscription("geometry_msgs/msg/PoseStamped", f"/{NAME}/pose", self._on_pose)
        self.create_subscription("crazyflie_interfaces/msg/Status", f"/{NAME}/status",
                                 self._on_status)  # fmt: skip
        self.results: list[LegProgress] = []
        self._here = (0.0, 0.0, 0.0)  # the last pose that arrived
        self._critical = 0  # reports in a row
        self._trouble = ""  # why it has to land
        self._legs: Iterator[Leg] = iter(())

    def fly(
        self, legs: Sequence[Leg], on_leg: Callable[[int], None], on_end: Callable[[], None]
    ) -> None:
        """Take off, fly the legs, and land.

        Parameters
        ----------
        legs
            At least one.
        on_leg
            Called with the number of each leg, from 1, when it begins.
        on_end
            Called after the landing.
        """
        self._legs, self._on_leg, self._on_end = iter(legs), on_leg, on_end
        start = legs[0]
        self._before: _Place = (*self._here[:2], 0.0, 0.0)
        self._begin(Leg("waypoint", start.x, start.y, start.z, start.yaw, start.z / CLIMB_M_S))
        self._timer = self.create_timer(SETPOINT_NS, self._update)
        self.info("Taking off")

    def _begin(self, leg: Leg) -> None:
        self._leg, self._begun_ns = leg, self.now_ns

    def _update(self) -> None:
        """Send the next setpoint; begin the next leg at the end of one."""
        time_s = (self.now_ns - self._begun_ns) / SECOND
        wanted = place(self._leg, self._before, time_s)
        self._send(wanted)
        if self._trouble:
            self._end("aborted")
        elif time_s >= self._leg.seconds:
            if math.dist(self._here, wanted[:3]) <= NEAR_M:
                self._end("succeeded")
            elif time_s >= self._leg.seconds + LATE_S:
                self._trouble = f"{NAME} is not where it should be"

    def _end(self, outcome: Literal["succeeded", "aborted"]) -> None:
        self._before = place(self._leg, self._before, (self.now_ns - self._begun_ns) / SECOND)
        if self.results:
            self.results[-1].ended_ns, self.results[-1].outcome = self.now_ns, outcome
            self.info(f"Leg {len(self.results)} {outcome}")
        leg = None if self._trouble else next(self._legs, None)
        if leg is None:
            self._land()
            return
        self._begin(leg)
        self.results.append(LegProgress(self.now_ns))
        self._on_leg(len(self.results))

    def _land(self) -> None:
        if self._trouble:
            self.error(f"Landing: {self._trouble}")
        self._timer.cancel()
        x, y, z, yaw = self._before
        self._begin(Leg("waypoint", x, y, 0.0, yaw, z / CLIMB_M_S + 1.0))
        self._timer = self.create_timer(SETPOINT_NS, self._descend)

    def _descend(self) -> None:
        time_s = (self.now_ns - self._begun_ns) / SECOND
        self._send(place(self._leg, self._before, time_s))
        if time_s >= self._leg.seconds:
            self._timer.cancel()
            self.info("Landed")
            self._on_end()

    def _send(self, wanted: _Place) -> None:
        x, y, z, yaw = wanted
        stamped = header(self.now_ns, FRAME)
        turn = _Quaternion(0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0))
        later_s = (self.now_ns - self._begun_ns + SETPOINT_NS) / SECOND
        ahead = np.subtract(place(self._leg, self._before, later_s), wanted) * SECOND / SETPOINT_NS
        still = _Vector3(0.0, 0.0, 0.0)
        speed = _Vector3(*ahead[:3].tolist())
        self._full_state.publish(
            _FullState(stamped, _Pose(_Point(x, y, z), turn), _Twist(speed, still), still)
        )

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
