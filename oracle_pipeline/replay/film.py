"""A run as a film from above: one frame for each moment of a scene.

Static parts are drawn once; a frame is a copy of them with the moving parts on top.
"""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from numpy.typing import NDArray
from PIL import Image

from oracle_pipeline.bags.terminal import progress_bar
from oracle_pipeline.datasets import replacing
from oracle_pipeline.replay import scene as scenes
from oracle_pipeline.reporting.figures import AMBER, COLORS, INK, SERIES, house_style

# Suffix of a film -> Pillow's options.
FORMATS: dict[str, dict[str, Any]] = {
    ".gif": {"format": "GIF", "optimize": True},
    ".webp": {"format": "WEBP", "lossless": True, "method": 1, "quality": 20},
}
LAST_FRAME_MS = 2000
PALETTE = 96  # colours of a film
PALETTE_FRAMES = 8  # frames to choose them from
SIX_BITS = np.uint8(0b11111100)

PAPER = "white"  # GIF has no partial transparency
WIDTH_IN, HEAD_IN, FOOT_IN, DPI = 6.4, 0.66, 0.92, 100
FLATTEST, TALLEST = 0.4, 1.2  # limits of height / width of the world
ROBOT_RADIUS_M = 0.22  # of a TurtleBot3, from Nav2's parameters
DRIVEN, SEEN, ATTACK, COST = COLORS["normal"], COLORS["control"], COLORS["malicious"], SERIES[3]
INKS = (INK, AMBER, DRIVEN, SEEN, ATTACK, COST)
FAILED: dict[str, Any] = {"color": INK, "marker": "X", "ls": "", "ms": 8, "mec": PAPER}

# A colour for each byte of a costmap, in a few steps to keep films small. 99 is the inscribed
# radius, 100 is the obstacle.
_COSTS = np.zeros((256, 4))
_COSTS[:, :3] = to_rgb(COST)
_COSTS[:101, 3] = 0.06 + 0.06 * (np.arange(101) // 20)
_COSTS[99:101, 3] = 0.45, 1.0
COST_COLORS = ListedColormap(_COSTS)


def save_film(scene: scenes.ReplayScene, path: Path, speed: float) -> None:
    """Write a scene as an animated GIF or WebP, by the suffix of the path.

    A progress bar is shown on standard error if it is a terminal.

    Parameters
    ----------
    scene : Scene
        With moments.
    path : Path
        Replaced atomically.
    speed : float
        Seconds of the run per second of the film.
    """
    times_s = np.array([moment.time_s for moment in scene.moments])
    shown_ms = np.append(np.diff(times_s) / speed * 1000.0, LAST_FRAME_MS)
    film = _Film(scene)
    palette = _palette(film, scene)
    moments = progress_bar(scene.moments, unit="frame", desc=path.name)
    frames = (_indexed(film.frame(moment), palette) for moment in moments)
    with replacing(path) as sink:
        next(frames).save(
            sink, save_all=True, append_images=frames, loop=0,
            duration=np.rint(shown_ms).astype(int).tolist(), **FORMATS[path.suffix],
        )  # fmt: skip


def frames(scene: scenes.ReplayScene) -> Iterator[tuple[float, bytes]]:
    """Yield the time [s] and the frame, as PNG, of each moment of a scene."""
    film = _Film(scene)
    palette = _palette(film, scene)
    for moment in scene.moments:
        sink = io.BytesIO()
        _indexed(film.frame(moment), palette).save(sink, "PNG")
        yield moment.time_s, sink.getvalue()


def _palette(film: "_Film", scene: scenes.ReplayScene) -> Image.Image:
    """Return a palette of the inks and the most frequent colours in some frames."""
    some = scene.moments[:: max(1, len(scene.moments) // PALETTE_FRAMES)]
    sheet = Image.fromarray(np.concatenate([film.frame(moment) for moment in some]) & SIX_BITS)
    counted: Any = sheet.getcolors(sheet.width * sheet.height)  # not None: the limit is not reached
    inks = [tuple(int(255 * level) & 0b11111100 for level in to_rgb(ink)) for ink in INKS]
    colors = list(dict.fromkeys([*inks, *(color for _, color in sorted(counted, reverse=True))]))
    palette = Image.new("P", (1, 1))
    palette.putpalette([level for color in colors[:PALETTE] for level in color])
    return palette


def _indexed(frame: NDArray[np.uint8], palette: Image.Image) -> Image.Image:
    """Return a frame in the colours of a palette; Pillow compares only the upper six bits."""
    image = Image.fromarray(frame & SIX_BITS).quantize(palette=palette, dither=Image.Dither.NONE)
    image.putpalette([level | 0b11 for level in image.getpalette() or ()])  # restores pure white
    return image


class _Film:
    """A figure with static parts that are drawn once, and moving parts."""

    def __init__(self, scene: scenes.ReplayScene) -> None:
        (left, low), (right, high) = scene.corners()
        world_in = WIDTH_IN * float(np.clip((high - low) / (right - left), FLATTEST, TALLEST))
        height_in = HEAD_IN + world_in + FOOT_IN
        with house_style():
            self._figure = Figure((WIDTH_IN, height_in), dpi=DPI, facecolor=PAPER)
            canvas: Any = FigureCanvasAgg(self._figure)  # it has no types
            self._parts = (
                _World(self._add_axes(0.0, FOOT_IN, WIDTH_IN, world_in), scene),
                _Timeline(self._add_axes(0.25, 0.62, WIDTH_IN - 0.5, 0.09), scene),
                _Words(self._figure, scene),
            )
            self._figure.legend(
                handles=_legend(scene), loc="lower center", ncols=7, fontsize="small",
                columnspacing=1.3, handlelength=1.3, handletextpad=0.5,
            )  # fmt: skip
        for part in self._parts:
            for artist in part.moving:
                artist.set_animated(True)
        canvas.draw()
        self._canvas, self._background = canvas, canvas.copy_from_bbox(self._figure.bbox)

    def frame(self, moment: scenes.Moment) -> NDArray[np.uint8]:
        """Return the picture of one moment, RGB, shape (height, width, 3)."""
        self._canvas.restore_region(self._background)
        for part in self._parts:
            part.show(moment)
            for artist in part.moving:
                self._figure.draw_artist(artist)
        return np.array(self._canvas.buffer_rgba())[..., :3]

    def _add_axes(self, left: float, low: float, width: float, height: float) -> Axes:
        """Add axes at a position in inches."""
        across, up = self._figure.get_size_inches()
        return self._figure.add_axes((left / across, low / up, width / across, height / up))


class _World:
    """Map, goals, robot, path, plan, scans and costmap."""

    def __init__(self, axes: Axes, scene: scenes.ReplayScene) -> None:
        self._scene = scene
        axes.set_axis_off()
        scenes.draw_ground(axes, scene)
        axes.plot(*scene.goals[:, :2].T, **scenes.NOT_REACHED)
        self._driven = _line(axes, "-", DRIVEN, lw=1.6)
        self._plan = _line(axes, "-", AMBER, lw=1.6)
        self._attacked = _line(axes, "s", ATTACK, ms=3.0, mew=0, antialiased=False)
        self._scan = _line(axes, "s", SEEN, ms=2.0, mew=0, antialiased=False)
        self._fake = Circle((0.0, 0.0), **scenes.FAKE_OBJECT)
        (self._reached,) = axes.plot([], [], **scenes.REACHED)
        self._current = _line(axes, "o", AMBER, ms=19, mew=1.6, mfc="none")
        self._robot = Circle((0.0, 0.0), ROBOT_RADIUS_M, ec=DRIVEN, lw=1.8)
        self._robot.set_facecolor(to_rgba(PAPER, 0.85))
        axes.add_patch(self._fake)
        axes.add_patch(self._robot)
        self._heading = _line(axes, "-", DRIVEN, lw=1.8)
        self.moving: list[Artist] = [
            self._driven, self._plan, self._attacked, self._scan, self._fake,
            self._reached, self._current, self._robot, self._heading,
        ]  # fmt: skip
        costmaps = [moment.costmap for moment in scene.moments if moment.costmap is not None]
        self._costmap = scenes.draw_grid(axes, costmaps[0], COST_COLORS) if costmaps else None
        if self._costmap is not None:
            self.moving.insert(0, self._costmap)

    def show(self, moment: scenes.Moment) -> None:
        """Update all artists to one moment."""
        scene, (x, y, yaw) = self._scene, moment.robot
        if self._costmap is not None:
            self._costmap.set_visible(moment.costmap is not None)
            if moment.costmap is not None:
                scenes.set_grid(self._costmap, moment.costmap)
        self._driven.set_data(*scene.path[: moment.driven].T)
        self._plan.set_data(*moment.plan.T)
        self._scan.set_data(*moment.scan.T)
        self._attacked.set_data(*moment.attacked.T)
        self._fake.set_visible(moment.disc is not None)
        if moment.disc is not None:
            self._fake.set_center(moment.disc[:2])
            self._fake.set_radius(moment.disc[2])
        goal = scene.goal_at(moment.time_s)
        self._reached.set_data(*scene.goals[scene.reached(moment.time_s), :2].T)
        self._current.set_data(*scene.goals[[] if goal is None else [goal], :2].T)
        self._robot.set_center((x, y))
        rim = x + ROBOT_RADIUS_M * np.cos(yaw), y + ROBOT_RADIUS_M * np.sin(yaw)
        self._heading.set_data([x, rim[0]], [y, rim[1]])


class _Timeline:
    """The progress of the film, with the attack and the ends of goals."""

    def __init__(self, axes: Axes, scene: scenes.ReplayScene) -> None:
        axes.set(xlim=(0.0, scene.duration_s), ylim=(0.0, 1.0), yticks=[])
        axes.set_facecolor(to_rgba(INK, 0.2))
        axes.spines[:].set_visible(False)
        axes.xaxis.set_major_formatter("{x:g} s")
        axes.tick_params(length=0, labelsize="small")
        self._past = Rectangle((0.0, 0.0), 0.0, 1.0, color=INK)
        axes.add_patch(self._past)
        self.moving: list[Artist] = [self._past]
        if scene.onset_s is not None:
            during = [scene.onset_s, scene.duration_s]
            axes.plot(during, [1.7, 1.7], color=ATTACK, lw=2.5, clip_on=False)
            axes.text(scene.onset_s, 2.2, "attack", color=ATTACK, size="small", va="bottom")
        for goal in scene.results:
            if goal.ended_s is not None:
                style = scenes.REACHED if goal.outcome == "succeeded" else FAILED
                self.moving += axes.plot(goal.ended_s, 0.5, **style, clip_on=False)

    def show(self, moment: scenes.Moment) -> None:
        """Update the progress bar to one moment."""
        self._past.set_width(moment.time_s)


class _Words:
    """The title of the run, the time, and the status of goals and recoveries."""

    def __init__(self, figure: Figure, scene: scenes.ReplayScene) -> None:
        self._scene = scene
        height_in = figure.get_size_inches()[1]
        first, second = 1.0 - 0.12 / height_in, 1.0 - 0.38 / height_in
        figure.text(
            0.04, first, scene.title, size="large", weight="bold", va="top", parse_math=False
        )
        self._clock = figure.text(0.96, first, "", size="large", ha="right", va="top")
        self._status = figure.text(0.04, second, "", va="top")
        self.moving: list[Artist] = [self._clock, self._status]

    def show(self, moment: scenes.Moment) -> None:
        """Update the texts to one moment."""
        scene = self._scene
        goal, reached = scene.goal_at(moment.time_s), int(scene.reached(moment.time_s).sum())
        status = [f"to goal {goal + 1} of {len(scene.goals)}"] if goal is not None else []
        status += [f"{reached} reached"] if len(scene.goals) else []
        status += [f"recoveries: {moment.recoveries}"] if moment.recoveries else []
        self._status.set_text(" \N{MIDDLE DOT} ".join(status))
        self._clock.set_text(f"{moment.time_s:.1f} s")


def _line(axes: Axes, style: str, color: str, **options: Any) -> Line2D:
    (line,) = axes.plot([], [], style, color=color, **options)
    return line


def _legend(scene: scenes.ReplayScene) -> list[Artist]:
    """Return a legend entry for each kind of element in the film."""
    moments = scene.moments

    def dots(color: str, label: str) -> Line2D:
        return Line2D([], [], ls="", marker="o", ms=4, mew=0, color=color, label=label)

    samples: list[tuple[bool, Artist]] = [
        (any(len(m.scan) for m in moments), dots(SEEN, "scan")),
        (any(len(m.attacked) for m in moments), dots(ATTACK, "attacked scan")),
        (any(m.disc for m in moments), Patch(label="fake object", **scenes.FAKE_OBJECT)),
        (any(m.costmap for m in moments), Patch(color=to_rgba(COST, 0.5), lw=0, label="costmap")),
        (any(len(m.plan) for m in moments), Line2D([], [], color=AMBER, label="plan")),
        (True, Line2D([], [], color=DRIVEN, label="driven")),
        (len(scene.goals) > 0, Line2D([], [], label="goal", **{**scenes.REACHED, "ms": 8})),
    ]
    return [sample for shown, sample in samples if shown]
