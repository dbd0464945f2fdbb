"""Gazebo itself, as a node: the clock and the simulator's performance."""

from oracle_pipeline.bags.template import Template
from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND, SECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header, time_message

_Clock = message_class("rosgraph_msgs/msg/Clock")
_PerformanceMetrics = message_class("gazebo_msgs/msg/PerformanceMetrics")

_CLOCK = "rosgraph_msgs/msg/Clock"

CLOCK_NS = 100 * MILLISECOND
METRICS_NS = 200 * MILLISECOND


class Gazebo(Node):
    """The server: ``/clock`` and its own performance."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/gazebo")
        self._clock = self.create_publisher(_CLOCK, "/clock", qos.CLOCK)
        self._metrics = self.create_publisher(
            "gazebo_msgs/msg/PerformanceMetrics", "/performance_metrics"
        )
        self._time = Template(_Clock(time_message(0)), _CLOCK, ("clock.sec", "clock.nanosec"))
        self.create_timer(CLOCK_NS, self._tick)
        self.create_timer(METRICS_NS, self._report)

    def _tick(self) -> None:
        self._clock.publish_serialized(self._time.data(*divmod(self.now_ns, SECOND)))

    def _report(self) -> None:
        # Simulated time knows nothing of the real time it took.
        self._metrics.publish(_PerformanceMetrics(header(self.now_ns, ""), 1.0, []))
