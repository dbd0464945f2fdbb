"""The node that subscribes to all visible topics as bytes, and writes each interval's graph.

The work on graphs is done in ``interval_graphs``. This file is a thin shell around it. It needs
rclpy, so the tests of this repository do not cover it.
"""

from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rosidl_runtime_py.utilities import get_message

from oracle_graph_recorder.interval_graphs import IntervalGraphs, Traffic, full_name, snapshot
from oracle_pipeline.bags.graph_files import RosGraph
from oracle_pipeline.bags.protocol import is_hidden

_DISCOVERY_S = 0.1  # rosbag2 looks for new topics this often
_DEPTH = 100


class GraphRecorder(Node):
    """Subscribes to all topics and writes graphs into the folder of the parameter ``folder``."""

    def __init__(self) -> None:
        super().__init__("oracle_graph_recorder")
        folder = Path(self.declare_parameter("folder", "graphs").value)
        self._own = {full_name(self.get_name(), self.get_namespace())}
        self._subscribed: set[str] = set()
        self._graphs = IntervalGraphs(self._take, folder, self._now_ns())
        self.create_timer(_DISCOVERY_S, self._update)
        self.get_logger().info(f"Writing graphs to {folder.absolute()}")

    def finish(self) -> None:
        """Write the graph of the last, incomplete interval."""
        self._graphs.finish(self._now_ns())

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)  # simulated time with use_sim_time

    def _update(self) -> None:
        """Subscribe to new topics, and end the intervals that are over."""
        for topic, types in self.get_topic_names_and_types():
            if topic not in self._subscribed and not is_hidden(topic):
                self._subscribe(topic, min(types))
        self._graphs.pass_to(self._now_ns())

    def _subscribe(self, topic: str, msgtype: str) -> None:
        profiles = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
        if not profiles:
            return
        self._subscribed.add(topic)
        try:
            message_class = get_message(msgtype)
        except (AttributeError, ModuleNotFoundError, ValueError) as error:
            self.get_logger().warning(f"{topic} is not counted: {error}")
            return
        reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
        latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
        requested = QoSProfile(
            depth=_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )

        def count(data: bytes) -> None:
            self._graphs.traffic.count(topic, len(data))

        self.create_subscription(message_class, topic, count, requested, raw=True)

    def _take(self, traffic: Traffic) -> RosGraph:
        def compatible(offered: QoSProfile, requested: QoSProfile) -> bool:
            return qos_check_compatible(offered, requested)[0] != QoSCompatibility.ERROR

        return snapshot(self, traffic, compatible, leave_out=self._own)


def main() -> None:
    """Record until Ctrl-C."""
    rclpy.init()
    node = GraphRecorder()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.finish()
        node.destroy_node()
        rclpy.try_shutdown()
