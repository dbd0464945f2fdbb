"""A top-down view of a run: the scene to draw, and the still picture.

``oracle_pipeline.replay.film`` draws the same scene as a film.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgb, to_rgba
from matplotlib.image import AxesImage
from matplotlib.patches import Circle
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from oracle_pipeline.bags.manifest import GoalResult
from oracle_pipeline.reporting.figures import AMBER, COLORS, INK, drawing

MARGIN_M = 0.3  # around the shown part
OCCUPIED = 65  # occupancy from which the map server calls a cell an obstacle [%]

# A colour for each byte of an occupancy grid: 0 free to 100, 255 unknown.
_PAPER = np.zeros((256, 4))
_PAPER[:, :3] = to_rgb(INK)
_PAPER[OCCUPIED:101, 3], _PAPER[101:, 3] = 1.0, 0.12
MAP_COLORS = ListedColormap(_PAPER)

FAKE_OBJECT: dict[str, Any] = {"color": COLORS["malicious"], "alpha": 0.55, "lw": 0}
OBSTACLE: dict[str, Any] = {**FAKE_OBJECT, "color": AMBER}
REACHED: dict[str, Any] = {"color": AMBER, "marker": "*", "ls": "", "ms": 11}
NOT_REACHED: dict[str, Any] = {**REACHED, "mfc": to_rgba(AMBER, 0.15), "mec": AMBER}
LABEL_OFFSET = (5.0, 5.0)  # of a goal's number from the goal [points]


@dataclass(frozen=True, eq=False, slots=True)
class DrawnGrid:
    """An occupancy grid with its pose in the scene's frame."""

    cells: NDArray[np.int8]  # (rows, columns), row 0 at the lowest y; 0 free to 100, -1 unknown
    resolution_m: float  # edge of a cell
    origin: tuple[float, float, float]  # x, y, yaw of the lower left corner of cell (0, 0)

    def placement(self) -> Affine2D:
        """Return the transform from columns and rows of the grid to the scene."""
        x, y, yaw = self.origin
        return Affine2D().scale(self.resolution_m).rotate(yaw).translate(x, y)

    def known(self) -> NDArray[np.float64]:
        """Return two opposite corners of each known cell, shape (2 n, 2)."""
        cells = np.argwhere(self.cells >= 0)[:, ::-1]  # column, row
        return np.asarray(self.placement().transform(np.concatenate([cells, cells + 1])))


@dataclass(frozen=True, eq=False, slots=True)
class Moment:
    """The state at one instant: the newest data, transformed at the time of reception."""

    time_s: float  # since the start of the recording
    robot: tuple[float, float, float]  # x, y, yaw
    driven: int  # points of the scene's path until now
    scan: NDArray[np.float64]  # (m, 2)
    attacked: NDArray[np.float64]  # (m, 2), points of the attacked scan
    plan: NDArray[np.float64]  # (p, 2)
    costmap: DrawnGrid | None
    disc: tuple[float, float, float] | None  # x, y, radius of the fake object
    recoveries: int  # until now


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ReplayScene:
    """The scene of one run; metres and radians in one frame, seconds since its start."""

    title: str
    frame: str  # map (REP 105), or odom without localisation
    map: DrawnGrid | None
    path: NDArray[np.float64]  # (n, 2), of the robot
    start: tuple[float, float]
    duration_s: float
    # (k, 3): x, y, yaw, in the order they were given
    goals: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    results: tuple[GoalResult, ...] = ()  # of the first goals
    onset_s: float | None = None  # of the attack
    disc: tuple[float, float, float] | None = None  # x, y, radius of the fake object
    obstacle: tuple[float, float, float] | None = None  # x, y, radius of a real unmapped one
    # (m, 2), points of one scan: attacked, if there is an attack
    scan: NDArray[np.float64] | None = None
    moments: tuple[Moment, ...] = ()  # in order of time; empty for a still picture

    def reached(self, time_s: float = np.inf) -> NDArray[np.bool_]:
        """Return whether each goal was reached by a time, shape (k,)."""
        reached = np.zeros(len(self.goals), dtype=np.bool_)
        for number, goal in enumerate(self.results):
            ended_s = np.inf if goal.ended_s is None else goal.ended_s
            reached[number] = goal.outcome == "succeeded" and ended_s <= time_s
        return reached

    def goal_at(self, time_s: float) -> int | None:
        """Return the index of the active goal; None without one."""
        for number, goal in enumerate(self.results):
            if goal.accepted_s <= time_s < (np.inf if goal.ended_s is None else goal.ended_s):
                return number
        return None

    def surroundings(self) -> NDArray[np.float64]:
        """Return the points of the scans of all moments, shape (m, 2), in place of a map."""
        return np.concatenate([np.zeros((0, 2)), *(moment.scan for moment in self.moments)])

    def corners(self) -> NDArray[np.float64]:
        """Return the lower left and upper right corners of the scene, shape (2, 2)."""
        extents = [self.path, self.goals[:, :2], np.array([self.start])]
        if self.map is not None:
            extents.append(self.map.known())
        else:
            extents.append(self.surroundings())
        points = np.concatenate(extents)
        return np.stack([points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M])


def top_down(scene: ReplayScene) -> bytes:
    """Draw a scene as PNG, in the style of ``oracle_pipeline.reporting.figures``.

    The picture shows the known part of the map and the path.
    """
    reached = scene.reached()
    goals, missed = scene.goals[reached], scene.goals[~reached]
    with drawing(4.7, 5.0) as (axes, png):
        draw_ground(axes, scene)
        if scene.scan is not None:
            attacked = scene.onset_s is not None
            ink, name = ("malicious", "attacked scan") if attacked else ("control", "scan")
            axes.plot(*scene.scan.T, ".", color=COLORS[ink], ms=2, label=name)
        axes.plot(*scene.path.T, color=COLORS["normal"], lw=1.6, label="path")
        axes.plot(*scene.start, "s", color=COLORS["control"], ms=8, label="start")
        if len(goals):
            axes.plot(*goals[:, :2].T, **REACHED, label="goal reached")
        if len(missed):
            axes.plot(*missed[:, :2].T, **NOT_REACHED, label="not reached")
        if scene.disc is not None:
            x, y, radius = scene.disc
            axes.add_patch(Circle((x, y), radius, label="fake object", **FAKE_OBJECT))
        if scene.obstacle is not None:
            x, y, radius = scene.obstacle
            axes.add_patch(Circle((x, y), radius, label="real obstacle", **OBSTACLE))
        axes.set(xlabel=f"x in {scene.frame} [m]", ylabel=f"y in {scene.frame} [m]")
        axes.set_title(scene.title, parse_math=False)  # a name of a bag may have a dollar sign
        axes.figure.legend(loc="outside lower center", ncols=3, fontsize="small", markerscale=0.8)
    return png.getvalue()


def draw_ground(axes: Axes, scene: ReplayScene) -> None:
    """Draw the static parts (map, numbers of goals), and set the limits of the axes."""
    if scene.map is not None:
        draw_grid(axes, scene.map, MAP_COLORS)
    else:
        axes.plot(*scene.surroundings().T, ".", color=INK, ms=1.2, alpha=0.5, mew=0)
    goals = scene.goals[:, :2]
    for number, goal in enumerate(goals, 1):
        axes.annotate(str(number), goal, LABEL_OFFSET, textcoords="offset points")
    (left, low), (right, high) = scene.corners()
    axes.set(xlim=(left, right), ylim=(low, high), aspect="equal")


def draw_grid(axes: Axes, grid: DrawnGrid, colors: ListedColormap) -> AxesImage:
    """Draw a grid at its pose, with a colour for each value of its bytes."""
    image = AxesImage(axes, cmap=colors, interpolation="nearest", origin="lower")
    image.set_clim(0, 255)
    set_grid(image, grid)
    axes.add_image(image)
    image.set_clip_path(axes.patch)
    return image


def set_grid(image: AxesImage, grid: DrawnGrid) -> None:
    """Replace the grid of an image."""
    rows, columns = grid.cells.shape
    image.set_data(grid.cells.view(np.uint8))
    image.set_extent((0, columns, 0, rows))
    image.set_transform(grid.placement() + image.axes.transData)
