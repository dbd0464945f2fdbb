"""Quality-of-service profiles that Nav2 and Gazebo use.

A profile is ``rosbags.interfaces.Qos``, so what an endpoint offers is what a bag records.
"""

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

_INFINITE = QosTime(9223372036, 854775807)  # what rmw writes for "no limit"


def profile(
    depth: int, *, reliable: bool = True, latched: bool = False, lifespan: QosTime = _INFINITE
) -> Qos:
    """Return a keep-last profile; ``latched`` is durability transient local."""
    return Qos(
        history=QosHistory.KEEP_LAST, depth=depth,
        reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=_INFINITE, lifespan=lifespan, liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_INFINITE, avoid_ros_namespace_conventions=False,
    )  # fmt: skip


RELIABLE = profile(1)  # rclcpp::QoS(1)
DEFAULT = profile(10)  # rclcpp::QoS(10)
LATCHED = profile(1, latched=True)
SENSOR_DATA = profile(5, reliable=False)
SYSTEM = profile(1, reliable=False)  # rclcpp::SystemDefaultsQoS under Fast DDS
ROSOUT = profile(1000, latched=True, lifespan=QosTime(10, 0))
PARAMETER_EVENTS = profile(1000)
CLOCK = profile(1, reliable=False)
TF = profile(100)
