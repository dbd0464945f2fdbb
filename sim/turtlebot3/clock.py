"""The node of Gazebo's server: the clock and the simulator's performance."""

from oracle_pipeline.bags.template import STAMP, Template
from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.executor import MILLISECOND
from sim.middleware.node import Node
from sim.middleware.stamps import header, time_message

_CLOCK = "rosgraph_msgs/msg/Clock"
_METRICS = "gazebo_msgs/msg/PerformanceMetrics"

_Clock = message_class(_CLOCK)
_PerformanceMetrics = message_class(_METRICS)

CLOCK_NS = 100 * MILLISECOND
METRICS_NS = 200 * MILLISECOND


class Gazebo(Node):
    """Gazebo's server, which publishes ``/clock`` and its own performance."""

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/gazebo")
        self._clock = self.create_publisher(_CLOCK, "/clock", qos.CLOCK)
        self._metrics = self.create_publisher(_METRICS, "/performance_metrics")
        self._time = Template(_Clock(time_message(0)), _CLOCK, ("clock.sec", "clock.nanosec"))
        # The real time that the simulation takes is not available in simulated time.
        metrics = _PerformanceMetrics(header(0, ""), 1.0, [])
        self._performance = Template(metrics, _METRICS, STAMP)
        self.create_timer(CLOCK_NS, self._tick)
        self.create_timer(METRICS_NS, self._report)

    def _tick(self) -> None:
        self._clock.publish_serialized(self._time.data(*self.stamp))

    def _report(self) -> None:
        self._metrics.publish_serialized(self._performance.data(*self.stamp))
