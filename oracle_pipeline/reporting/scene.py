"""A run seen from above: map, way driven, start and goals, and the object that is not there."""

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle
from numpy.typing import NDArray

from oracle_pipeline.reporting.figures import AMBER, COLORS, INK, drawing

MARGIN_M = 0.3  # around what is shown
OCCUPIED = 65  # occupancy from which the map server calls a cell an obstacle [%]


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """What happened in one run; metres and radians in the map frame (REP 105)."""

    occupancy: NDArray[np.int8]  # (rows, columns), row 0 at the lowest y; 0 free to 100, -1 unknown
    resolution_m: float  # edge of a cell
    origin: tuple[float, float]  # lower left corner of cell (0, 0)
    path: NDArray[np.float64]  # (n, 2), where the robot went
    start: tuple[float, float]
    goals: NDArray[np.float64]  # (k, 3): x, y, yaw, in the order they were given
    disc: tuple[float, float, float] | None = None  # x, y, radius of an object that is not there
    scan: NDArray[np.float64] | None = None  # (m, 2), points of one attacked scan


def top_down(scene: Scene, title: str) -> bytes:
    """Draw a scene as PNG, in the inks of ``oracle_pipeline.reporting.figures``.

    The picture is cut to the part of the map that is known and to where the robot went.
    """
    rows, columns = scene.occupancy.shape
    x, y = scene.origin
    extent = (x, x + columns * scene.resolution_m, y, y + rows * scene.resolution_m)
    paper = np.zeros((rows, columns, 4))
    paper[..., :3] = to_rgb(INK)
    paper[..., 3] = np.select([scene.occupancy >= OCCUPIED, scene.occupancy < 0], [1.0, 0.12])

    with drawing(4.7, 5.0) as (axes, png):
        axes.imshow(paper, origin="lower", extent=extent, interpolation="nearest")
        if scene.scan is not None:
            axes.plot(*scene.scan.T, ".", color=COLORS["malicious"], ms=2, label="attacked scan")
        axes.plot(*scene.path.T, color=COLORS["normal"], lw=1.6, label="path")
        axes.plot(*scene.start, "s", color=COLORS["control"], ms=8, label="start")
        if len(scene.goals):
            axes.plot(*scene.goals[:, :2].T, "*", color=AMBER, ms=11, label="goals")
        for number, (goal_x, goal_y, _) in enumerate(scene.goals, start=1):
            axes.annotate(str(number), (goal_x, goal_y), (5, 4), textcoords="offset points")
        if scene.disc is not None:
            disc_x, disc_y, radius = scene.disc
            red = COLORS["malicious"]
            axes.add_patch(
                Circle((disc_x, disc_y), radius, color=red, alpha=0.55, lw=0, label="fake object")
            )
        (left, low), (right, high) = _known_corners(scene)
        axes.set(xlim=(left - MARGIN_M, right + MARGIN_M), ylim=(low - MARGIN_M, high + MARGIN_M))
        axes.set(aspect="equal", xlabel="x in map [m]", ylabel="y in map [m]", title=title)
        axes.figure.legend(loc="outside lower center", ncols=5, fontsize="small", markerscale=0.8)
    return png.getvalue()


def _known_corners(scene: Scene) -> NDArray[np.float64]:
    """Return the lower left and the upper right corner of what there is to see, shape (2, 2)."""
    cells = np.argwhere(scene.occupancy >= 0)[:, ::-1]  # column, row
    corners = np.concatenate([cells, cells + 1]) * scene.resolution_m + scene.origin
    seen = np.concatenate([corners, scene.path, scene.goals[:, :2], [scene.start]])
    return np.stack([seen.min(axis=0), seen.max(axis=0)])
