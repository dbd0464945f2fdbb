"""The velocity smoother: keeps commands within the robot's speeds and accelerations."""

from typing import Any, NamedTuple

from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import SECOND
from sim.nav2.lifecycle import LifecycleNode
from sim.nav2.messages import TWIST, twist_bytes, twist_message

FREQUENCY_HZ = 20
VELOCITY_TIMEOUT_NS = 1 * SECOND


class VelocityLimits(NamedTuple):
    """Limits of one component of the velocity (m and s, or rad and s)."""

    low: float
    high: float
    acceleration: float
    deceleration: float  # negative

    def scaled(self, speed: float) -> "VelocityLimits":
        """Return the limits of a slower robot with the same accelerations."""
        return self._replace(low=speed * self.low, high=speed * self.high)


LINEAR = VelocityLimits(-0.26, 0.26, 2.5, -2.5)
ANGULAR = VelocityLimits(-1.0, 1.0, 3.2, -3.2)


def smooth(current: float, command: float, limits: VelocityLimits) -> float:
    """Return the speed after one period on the way from ``current`` to ``command``.

    Speeding up is bounded by the acceleration, anything else, a change of direction included,
    by the deceleration.
    """
    command = min(max(command, limits.low), limits.high)
    speeding_up = abs(command) >= abs(current) and current * command >= 0.0
    bound = (limits.acceleration if speeding_up else -limits.deceleration) / FREQUENCY_HZ
    return current + min(max(command - current, -bound), bound)


class VelocitySmoother(LifecycleNode):
    """Publishes at 20 Hz while there is something to do.

    The feedback is open-loop: the last command counts as the robot's velocity. Without a
    command for a second the robot is ramped to a halt, after which nothing is published.

    Parameters
    ----------
    domain, latency_ns
        As for `LifecycleNode`.
    speed
        Share of the maximal speed that the robot may drive and turn at.
    """

    def __init__(self, domain: Domain, *, speed: float = 1.0, latency_ns: int = 0) -> None:
        super().__init__(domain, "/velocity_smoother", latency_ns=latency_ns)
        self._linear, self._angular = LINEAR.scaled(speed), ANGULAR.scaled(speed)
        self._command: tuple[float, float] | None = None
        self._command_ns = 0
        self._sent = (0.0, 0.0)
        self._stopped = False

    def on_configure(self) -> None:
        """Open the topics."""
        self._publisher = self.create_publisher(TWIST, "/cmd_vel_raw", qos.RELIABLE)
        self.create_subscription(TWIST, "/cmd_vel_nav", self._on_command, qos.RELIABLE)

    def on_activate(self) -> None:
        """Start the loop."""
        self.create_timer(SECOND // FREQUENCY_HZ, self._smooth)

    def _on_command(self, twist: Any) -> None:
        self._command = (twist.linear.x, twist.angular.z)
        self._command_ns = self.now_ns

    def _smooth(self) -> None:
        if self._command is None:
            return
        if self.now_ns - self._command_ns > VELOCITY_TIMEOUT_NS:
            if self._stopped or self._sent == (0.0, 0.0):
                self._stopped = True
                return
            self._command = (0.0, 0.0)
        self._stopped = False
        self._sent = (
            smooth(self._sent[0], self._command[0], self._linear),
            smooth(self._sent[1], self._command[1], self._angular),
        )
        self._publisher.publish(twist_message(*self._sent), twist_bytes(*self._sent))
