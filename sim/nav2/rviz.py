"""RViz with Nav2's default view: in the graph, but without messages, as if no one clicks."""

from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.middleware.node import Node
from sim.nav2 import actions

_GRID = "nav_msgs/msg/OccupancyGrid"
_PATH = "nav_msgs/msg/Path"
_POINTS = "sensor_msgs/msg/PointCloud2"
_UPDATE = "map_msgs/msg/OccupancyGridUpdate"

_DISPLAYS = (
    ("/scan", "sensor_msgs/msg/LaserScan", qos.SENSOR_DATA),
    ("/map", _GRID, qos.LATCHED),
    ("/map_updates", _UPDATE, qos.DEFAULT),
    ("/particle_cloud", "nav2_msgs/msg/ParticleCloud", qos.SENSOR_DATA),
    ("/plan", _PATH, qos.DEFAULT),
    ("/local_plan", _PATH, qos.DEFAULT),
    ("/waypoints", "visualization_msgs/msg/MarkerArray", qos.DEFAULT),
    ("/global_costmap/costmap", _GRID, qos.LATCHED),
    ("/global_costmap/costmap_updates", _UPDATE, qos.DEFAULT),
    ("/global_costmap/voxel_marked_cloud", _POINTS, qos.DEFAULT),
    ("/local_costmap/costmap", _GRID, qos.LATCHED),
    ("/local_costmap/costmap_updates", _UPDATE, qos.DEFAULT),
    ("/local_costmap/voxel_marked_cloud", _POINTS, qos.DEFAULT),
    ("/local_costmap/published_footprint", "geometry_msgs/msg/PolygonStamped", qos.DEFAULT),
    ("/downsampled_costmap", _GRID, qos.LATCHED),
    ("/downsampled_costmap_updates", _UPDATE, qos.DEFAULT),
    ("/mobile_base/sensors/bumper_pointcloud", _POINTS, qos.DEFAULT),
)


class RViz(Node):
    """The window, which subscribes to the topics of the default view.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    """

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/rviz", endpoints="PE")
        self.create_publisher("geometry_msgs/msg/PointStamped", "/clicked_point")
        self.create_publisher("geometry_msgs/msg/PoseWithCovarianceStamped", "/initialpose")
        for topic, msgtype, profile in _DISPLAYS:
            self.create_subscription(msgtype, topic, None, profile)
        for name in ("navigate_to_pose", "navigate_through_poses"):
            feedback = f"{actions.action_type(name)}_FeedbackMessage"
            self.create_subscription(feedback, f"/{name}/_action/feedback", None)
            self.create_subscription(
                "action_msgs/msg/GoalStatusArray", f"/{name}/_action/status", None, qos.LATCHED
            )


class NavigationDialog(Node):
    """The Navigation 2 panel's client of the navigation actions.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    """

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain, "/rviz_navigation_dialog_action_client", endpoints="PE")
        self.create_publisher("visualization_msgs/msg/MarkerArray", "/waypoints")
        for name in ("navigate_to_pose", "navigate_through_poses", "follow_waypoints"):
            actions.client(self, name)
