"""The smoother server: smooths paths on request; the default tree never requests it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from oracle_pipeline.bags.types import message_class
from sim.middleware import qos
from sim.middleware.action import ActionServer, GoalHandle
from sim.middleware.domain import Domain
from sim.middleware.stamps import duration_message, stamp_ns
from sim.middleware.tf import TransformBuffer, TransformListener
from sim.nav2.costmap import INSCRIBED, Costmap2D, point_costs
from sim.nav2.lifecycle import LifecycleNode
from sim.nav2.paths import PATH, path_bytes, path_message, path_poses

_ACTION = "nav2_msgs/action/SmoothPath"
_Result = message_class(f"{_ACTION}_Result")

DATA_WEIGHT = 0.2  # pull towards the original path
SMOOTH_WEIGHT = 0.3  # pull towards the middle between the neighbours
REFINEMENTS = 4  # number of further passes (do_refinement)


class SmootherServer(LifecycleNode):
    """Answers ``smooth_path``.

    Parameters
    ----------
    domain
        The domain that the node belongs to.
    listener
        Suffix of its transform listener's name.
    transforms
        Buffer to share with other listeners; its own if omitted.
    latency_ns
        From a message's publication to its arrival here.
    """

    def __init__(
        self,
        domain: Domain,
        listener: str,
        *,
        transforms: TransformBuffer | None = None,
        latency_ns: int = 0,
    ) -> None:
        super().__init__(domain, "/smoother_server", latency_ns=latency_ns)
        TransformListener(domain, listener, transforms)
        self._costmap: Any = None  # the latest nav2_msgs/msg/Costmap

    def on_configure(self) -> None:
        """Subscribe to the global costmap and offer the action."""
        self._smoothed = self.create_publisher(PATH, "/plan_smoothed", qos.RELIABLE)
        self.create_subscription(
            "nav2_msgs/msg/Costmap", "/global_costmap/costmap_raw", self._on_costmap, qos.LATCHED
        )
        self.create_subscription(
            "geometry_msgs/msg/PolygonStamped",
            "/global_costmap/published_footprint",
            None,
            qos.SYSTEM_SUBSCRIPTION,
        )
        ActionServer(self, _ACTION, "/smooth_path", self._on_goal, GoalHandle.canceled)

    def _on_costmap(self, message: Any) -> None:
        self._costmap = message

    def _on_goal(self, handle: GoalHandle) -> None:
        path = handle.goal.path
        poses = path_poses(path)
        if len(poses) < 2:
            handle.abort()
            return
        smoothed = smooth(poses[:, :2])
        is_free = self._costmap is None or bool(
            np.all(point_costs(Costmap2D.from_message(self._costmap), *smoothed.T) < INSCRIBED)
        )
        if is_free:
            poses[:, :2] = smoothed
        stamp, frame = stamp_ns(path.header.stamp), path.header.frame_id
        self._smoothed.publish_serialized(path_bytes(stamp, frame, poses))
        duration = duration_message(self.latency_ns)
        handle.succeed(_Result(path_message(stamp, frame, poses), duration, is_free))


def smooth(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the path that Nav2's simple smoother converges to; the ends stay where they are.

    Its sweeps move every point until the pull of the original and that of the neighbours cancel
    out, so their result is the solution of a tridiagonal system; each refinement begins with
    it.

    Parameters
    ----------
    points
        Shape (n, 2), n at least 2 [m].
    """
    n = len(points)
    bands = np.zeros((3, n))
    bands[1] = 1.0
    bands[1, 1:-1] = DATA_WEIGHT + 2.0 * SMOOTH_WEIGHT
    bands[0, 2:] = bands[2, :-2] = -SMOOTH_WEIGHT
    for _ in range(1 + REFINEMENTS):
        right = points.copy()
        right[1:-1] *= DATA_WEIGHT
        points = solve_banded((1, 1), bands, right)
    return points
