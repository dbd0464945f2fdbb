"""The waypoint follower, which no client here requests: its endpoints."""

from sim.middleware.action import ActionClient, ActionServer
from sim.middleware.domain import Domain
from sim.nav2.lifecycle import LifecycleNode, not_served


class WaypointFollower(LifecycleNode):
    """Offers ``/follow_waypoints``.

    Parameters
    ----------
    domain, latency_ns
        As for `LifecycleNode`.
    """

    def __init__(self, domain: Domain, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/waypoint_follower", latency_ns=latency_ns)

    def on_configure(self) -> None:
        """Open the actions."""
        ActionClient(self, "nav2_msgs/action/NavigateToPose", "/navigate_to_pose")
        ActionServer(self, "nav2_msgs/action/FollowWaypoints", "/follow_waypoints", not_served)
