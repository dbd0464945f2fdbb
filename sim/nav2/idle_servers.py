"""The servers that no client here requests: their endpoints, without the work."""

from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.nav2 import actions
from sim.nav2.costmap import COSTMAP
from sim.nav2.footprint import POLYGON
from sim.nav2.lifecycle import LifecycleNode
from sim.nav2.paths import PATH


class SmootherServer(LifecycleNode):
    """Offers ``smooth_path``.

    Parameters
    ----------
    domain, latency_ns
        As for `LifecycleNode`.
    """

    def __init__(self, domain: Domain, *, latency_ns: int = 0) -> None:
        super().__init__(domain, "/smoother_server", latency_ns=latency_ns)

    def on_configure(self) -> None:
        """Open the topics and offer the action."""
        self.create_publisher(PATH, "/plan_smoothed", qos.RELIABLE)
        self.create_subscription(COSTMAP, "/global_costmap/costmap_raw", None, qos.LATCHED)
        self.create_subscription(POLYGON, "/global_costmap/published_footprint", None, qos.SYSTEM)
        actions.leave_unserved(self, ["smooth_path"])


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
        actions.client(self, "navigate_to_pose")
        actions.leave_unserved(self, ["follow_waypoints"])
