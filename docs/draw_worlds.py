"""Draws ``docs/images/worlds.png``: one arena of each kind with the patrol of its block."""

from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from sim.campaigns import DEFAULT_SEED
from sim.nav2.navfn import plan
from sim.turtlebot3.drawing import draw_block, planning_grid
from sim.turtlebot3.floor_plans import KINDS
from sim.turtlebot3.map import occupancy_map

GOALS = 4
WIDTH_M, HEIGHT_M = 8.2, 6.4  # of a picture, around the middle of the arena
PATH, OBJECT = "#0072b2", "#d55e00"  # colours that colour-blind people distinguish


def draw_arena(ax: Axes, block: int) -> None:
    """Draw the map of a block, its patrol, and where its fake object would stand."""
    drawn = draw_block(DEFAULT_SEED, block, GOALS)
    world, grid = occupancy_map(drawn.arena), planning_grid(drawn.arena)
    x, y = world.origin
    rows, columns = world.data.shape
    extent = (x, x + columns * world.resolution, y, y + rows * world.resolution)
    ax.imshow(world.data > 50, extent=extent, origin="lower", cmap="Greys", vmax=1.4)
    stops = [drawn.start, *drawn.goals]
    for number, (begin, end) in enumerate(pairwise(stops), 1):
        path = plan(grid, (begin.x, begin.y), (end.x, end.y))
        if path is not None:
            ax.plot(*path.T, color=PATH, linewidth=1.5)
        ax.annotate(str(number), (end.x, end.y), color=PATH, weight="bold",
                    xytext=(4, 4), textcoords="offset points")  # fmt: skip
    ax.plot(drawn.start.x, drawn.start.y, "o", color=PATH)
    ax.annotate("start", (drawn.start.x, drawn.start.y), color=PATH,
                xytext=(5, -11), textcoords="offset points")  # fmt: skip
    there = drawn.fake_object
    ax.add_patch(Circle((there.x, there.y), there.radius, color=OBJECT))
    ax.annotate("fake object", (there.x, there.y), color=OBJECT,
                xytext=(9, 6), textcoords="offset points")  # fmt: skip
    ax.set(title=f"{drawn.arena.kind} (block {block})", xlim=(-WIDTH_M / 2, WIDTH_M / 2),
           ylim=(-HEIGHT_M / 2, HEIGHT_M / 2), aspect="equal", xticks=[], yticks=[])  # fmt: skip


def main(image: Path) -> None:
    """Draw the first blocks, one of each kind."""
    fig: Figure
    fig, axs = plt.subplots(1, len(KINDS), figsize=(11, 3.3), layout="constrained")
    for block, ax in enumerate(axs):
        draw_arena(ax, block)
    fig.savefig(image, dpi=110)


if __name__ == "__main__":
    main(Path(__file__).parent / "images" / "worlds.png")
