"""The map server: publishes an occupancy map once, latched, and swaps it on request."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.middleware import qos
from sim.middleware.domain import Domain
from sim.nav2.costmap import occupancy_grid_message
from sim.nav2.lifecycle import LifecycleNode


@dataclass(frozen=True, slots=True)
class OccupancyMap:
    """An occupancy map, in the map frame."""

    data: NDArray[np.int8]  # (height, width): 0 free, 100 occupied, -1 unknown
    resolution: float  # edge of a cell [m]
    origin: tuple[float, float]  # outer corner of cell (0, 0) [m]


class MapServer(LifecycleNode):
    """Publishes one of several maps.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    maps
        The maps that ``load_map`` can load, by name.
    name
        The first map.
    """

    def __init__(self, domain: Domain, maps: Mapping[str, OccupancyMap], name: str) -> None:
        super().__init__(domain, "/map_server")
        self._maps = maps
        self._name = name
        self._publisher = self.create_publisher("nav_msgs/msg/OccupancyGrid", "/map", qos.LATCHED)
        self.create_service("nav_msgs/srv/GetMap", "/map_server/map", self._get_map)
        self.create_service("nav2_msgs/srv/LoadMap", "/map_server/load_map", self._load_map)

    def on_activate(self) -> None:
        """Publish the map."""
        self._publisher.publish(self._message())

    def _get_map(self, _request: None) -> Any:
        return self._message()

    def _load_map(self, name: str) -> bool:
        """Publish the map of that name; False if there is none."""
        if name not in self._maps:
            self.error(f"There is no map {name!r}; known are {', '.join(self._maps)}.")
            return False
        self._name = name
        self._publisher.publish(self._message())
        return True

    def _message(self) -> Any:
        chosen = self._maps[self._name]
        return occupancy_grid_message(
            self.now_ns, "map", chosen.data, chosen.resolution, *chosen.origin
        )
