"""Nav2 as ``tb3_simulation_launch.py`` starts it on Humble, with collision monitor and client.

This module makes and connects the nodes, with their lifecycle managers. ``sim.turtlebot3`` adds the
nodes of the simulator.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from sim.middleware.domain import Domain
from sim.middleware.node import Node
from sim.middleware.tf import TransformBuffer, TransformListener
from sim.nav2.amcl import Amcl
from sim.nav2.basic_navigator import BasicNavigator
from sim.nav2.behavior_server import BehaviorServer
from sim.nav2.bt_navigator import BtNavigator
from sim.nav2.collision_monitor import (
    POLYGONS,
    SOURCES,
    STOCK_POLYGONS,
    CollisionMonitor,
    PointSource,
)
from sim.nav2.controller_server import ControllerServer
from sim.nav2.costmap_node import GlobalCostmap, LocalCostmap
from sim.nav2.idle_servers import SmootherServer, WaypointFollower
from sim.nav2.lifecycle import LifecycleManager
from sim.nav2.map_server import MapServer, OccupancyMap
from sim.nav2.parameters import settings
from sim.nav2.planner_server import PlannerServer
from sim.nav2.rviz import NavigationDialog, RViz
from sim.nav2.velocity_smoother import VelocitySmoother

OBSTACLE_SOURCES = ("/scan", "/scan_fakeobject")  # of both costmaps


@dataclass(frozen=True, slots=True)
class Nav2:
    """The parts of a running Nav2 that an experiment uses."""

    navigator: BasicNavigator
    managers: tuple[LifecycleManager, ...]
    collision_monitor: CollisionMonitor

    @property
    def is_active(self) -> bool:
        """Return whether all managed nodes are active, so that goals can be sent."""
        return all(manager.is_active for manager in self.managers)


def bring_up(
    domain: Domain, world_map: OccupancyMap, *, generator: Callable[[str], np.random.Generator],
    latency_ns: int = 0, run: int = 0, monitored: Sequence[PointSource] = SOURCES,
    speed: float = 1.0, stock: bool = False, parameters: Mapping[str, float] = MappingProxyType({}),
) -> Nav2:  # fmt: skip
    """Add Nav2 to a domain; it becomes active when AMCL has got the initial pose.

    Parameters
    ----------
    domain
        The domain with the nodes of the simulator.
    world_map
        The map to navigate on.
    generator
        Returns the generator of a node, by its name.
    latency_ns
        Of every node that processes messages, from a sample's publication to its callback.
    run
        Index of the run: process ids and addresses in node names come from it.
    monitored
        Topics that the collision monitor takes its points from.
    speed
        Share of its maximal speed that the robot may drive and turn at.
    stock
        Settings as Nav2 ships them, and not those that are tuned to narrow gaps;
        docs/explanation/navigation.md lists what differs.
    parameters
        Further values, by the names of ``sim.nav2.parameters``.

    Raises
    ------
    RecipeError
        If there is no such parameter, or it cannot have that value.
    """
    values = settings(stock=stock, given=parameters)

    def listening(owner: str, shared: TransformBuffer | None = None) -> TransformBuffer:
        """Add the transform listener of a node, with a number in place of its heap address."""
        suffix = f"5581{zlib.crc32(f'{owner}#{run}'.encode()):08x}"
        return TransformListener(domain, suffix, shared).buffer

    # All listeners receive the same, so one of them fills the buffer of all.
    transforms = listening("rviz")

    Node(domain, "/nav2_container", endpoints="E")
    Node(domain, f"/launch_ros_{4000 + run}", endpoints="P")

    MapServer(domain, world_map)
    Amcl(domain, listening("amcl", transforms), rng=generator("/amcl"), latency_ns=latency_ns)
    local_costmap = LocalCostmap(
        domain, listening("local_costmap", transforms), OBSTACLE_SOURCES,
        rng=generator("/local_costmap/local_costmap"), latency_ns=latency_ns,
        inflation=values.local_inflation,
    )  # fmt: skip
    global_costmap = GlobalCostmap(
        domain, listening("global_costmap", transforms), OBSTACLE_SOURCES,
        rng=generator("/global_costmap/global_costmap"), latency_ns=latency_ns,
        inflation=values.global_inflation,
    )  # fmt: skip
    dwb = values.dwb
    ControllerServer(
        domain,
        local_costmap,
        transforms,
        parameters=dwb._replace(
            max_vel_x=speed * dwb.max_vel_x, max_vel_theta=speed * dwb.max_vel_theta
        ),
        faces_paths=not stock,
        latency_ns=latency_ns,
    )
    listening("smoother_server", transforms)
    SmootherServer(domain, latency_ns=latency_ns)
    PlannerServer(domain, global_costmap, latency_ns=latency_ns)
    BehaviorServer(domain, listening("behavior_server", transforms), latency_ns=latency_ns)
    BtNavigator(domain, transforms, latency_ns=latency_ns)
    WaypointFollower(domain, latency_ns=latency_ns)
    VelocitySmoother(domain, speed=speed, latency_ns=latency_ns)
    collision_monitor = CollisionMonitor(
        domain,
        listening("collision_monitor", transforms),
        polygons=STOCK_POLYGONS if stock else POLYGONS,
        sources=monitored,
        latency_ns=latency_ns,
    )

    managers = (
        LifecycleManager(domain, "/lifecycle_manager_localization", ["/map_server", "/amcl"]),
        LifecycleManager(
            domain,
            "/lifecycle_manager_navigation",
            [
                "/controller_server", "/smoother_server", "/planner_server", "/behavior_server",
                "/bt_navigator", "/waypoint_follower", "/velocity_smoother",
            ],
        ),
        LifecycleManager(domain, "/lifecycle_manager", ["/collision_monitor"]),
    )  # fmt: skip

    RViz(domain)
    NavigationDialog(domain)
    return Nav2(BasicNavigator(domain, latency_ns=latency_ns), managers, collision_monitor)
