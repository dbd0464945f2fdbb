"""The map server: publishes an occupancy map once, latched."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.nav2.costmap import occupancy_grid_message
from sim.nav2.lifecycle import LifecycleNode, nothing


@dataclass(frozen=True, slots=True)
class OccupancyMap:
    """An occupancy map, in the map frame."""

    data: NDArray[np.int8]  # (height, width): 0 free, 100 occupied, -1 unknown
    resolution: float  # edge of a cell [m]
    origin: tuple[float, float]  # outer corner of cell (0, 0) [m]


class MapServer(LifecycleNode):
    """Publishes the map.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    world_map
        The map.
    """

    def __init__(self, domain: Domain, world_map: OccupancyMap) -> None:
        super().__init__(domain, "/map_server")
        self._map = world_map
        self._publisher = self.create_publisher("nav_msgs/msg/OccupancyGrid", "/map", qos.LATCHED)
        self.create_service("nav_msgs/srv/GetMap", "/map_server/map", nothing)
        self.create_service("nav2_msgs/srv/LoadMap", "/map_server/load_map", nothing)

    def on_activate(self) -> None:
        """Publish the map."""
        message = occupancy_grid_message(
            self.now_ns, "map", self._map.data, self._map.resolution, *self._map.origin
        )
        self._publisher.publish(message)
