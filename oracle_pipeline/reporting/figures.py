"""The style of all our pictures, which are PNG bytes, and the colours of labels in them.

Pictures are transparent, in colours with equal contrast to white and to near-black, so one file is
readable in light and dark mode. Labels differ in marker as well as in colour. Nothing depends on
the clock, files or the user's Matplotlib settings: the same numbers give the same bytes.

"""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

INK = "#757a83"
AMBER = "#a8761a"
COLORS = {"normal": "#3f83d8", "control": "#1f9486", "malicious": "#d4583a"}
MARKERS = {"normal": "o", "control": "s", "malicious": "^"}
SERIES = ("#3f83d8", "#d4583a", "#1f9486", "#8b6fd0", AMBER)

DPI = 160
PALETTE = 128  # colours of a picture; saves two thirds of the bytes in Dagster's event log

_STYLE = Path(__file__).with_name("house.mplstyle")


@contextmanager
def house_style() -> Iterator[None]:
    """Use the style of all our pictures, regardless of the user's settings."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(mpl.rc_params_from_file(_STYLE, use_default_template=False))
        yield


@contextmanager
def drawing(width: float, height: float) -> Iterator[tuple[Axes, BytesIO]]:
    """Yield the axes of a figure [inches], and a buffer that has its PNG after the block."""
    png = BytesIO()
    with house_style():
        figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        yield figure.add_subplot(), png
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = bytes(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        picture = Image.frombuffer("RGBA", canvas.get_width_height(), pixels)
        palette = picture.quantize(PALETTE, method=Image.Quantize.FASTOCTREE)
        palette.save(png, "png", dpi=(DPI, DPI))
