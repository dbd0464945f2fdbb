import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from oracle_pipeline.bags.manifest import GoalResult
from oracle_pipeline.replay.scene import DrawnGrid, ReplayScene, top_down
from oracle_pipeline.reporting.figures import AMBER, COLORS, INK, MARKERS, SERIES

X = np.random.default_rng(0).normal(size=(30, 4))
SCENE = ReplayScene(
    title="fake_object|run003",
    frame="map",
    map=DrawnGrid(np.array([[-1, 0, 100], [0, 0, 100]], dtype=np.int8), 0.5, (-1.0, -2.0, 0.1)),
    path=np.array([[0.0, 0.0], [0.5, 0.2]]),
    start=(0.0, 0.0),
    duration_s=10.0,
    goals=np.array([[0.4, 0.2, 0.0], [0.4, 0.3, 0.0]]),
    results=(GoalResult(1.0, 5.0, "succeeded", driven_m=1.0, recoveries=0),),
    disc=(0.2, 0.1, 0.15),
    scan=X[:, :2],
)
EMPTY = ReplayScene(
    title="", frame="odom", map=None, path=np.zeros((1, 2)), start=(0.0, 0.0), duration_s=0.0
)
PICTURES = {"run": lambda: top_down(SCENE), "run of which little is known": lambda: top_down(EMPTY)}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_depends_only_on_its_numbers_and_does_not_change_settings(name):
    before = dict(mpl.rcParams)
    first = PICTURES[name]()
    with mpl.rc_context({"lines.linewidth": 7, "font.size": 30, "savefig.dpi": 20}):
        second = PICTURES[name]()
    assert first.startswith(b"\x89PNG\r\n")
    assert first == second
    assert dict(mpl.rcParams) == before


def luminance(color):
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(color)]
    return np.dot(linear, [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("paper", ["#ffffff", "#0f1216"])
@pytest.mark.parametrize("ink", sorted({INK, AMBER, *COLORS.values(), *SERIES}))
def test_every_ink_is_readable_on_light_and_dark_paper(ink, paper):
    dark, light = sorted([luminance(ink), luminance(paper)])
    wanted = 4.3 if ink == INK else 3.0  # WCAG asks 3 of graphics and large text
    assert (light + 0.05) / (dark + 0.05) > wanted


def test_labels_differ_without_colour():
    assert len(set(MARKERS.values())) == len(COLORS)
