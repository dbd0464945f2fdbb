"""What all pages share: Jinja templates, embedded pictures, and links to the pages of runs."""

import base64
import functools
from typing import NamedTuple

import jinja2
import numpy as np

from oracle_pipeline.reporting.figures import DPI
from oracle_pipeline.reporting.tables import NO_FIGURE


class Picture(NamedTuple):
    """A picture inside the page."""

    alt: str
    caption: str
    uri: str
    width: int  # [CSS px]


@functools.cache
def template(name: str) -> jinja2.Template:
    """Return a template of the folder ``templates``; values are HTML-escaped."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("oracle_pipeline.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "run_page": run_page}
    return environment.get_template(name)


def number(value: float, spec: str = ".3g", unit: str = "") -> str:
    """Return a number with its unit, or a mark if it is unknown.

    Examples
    --------
    >>> number(0.123456, unit="m"), number(float("nan"))
    ('0.123 m', 'n/a')
    """
    return NO_FIGURE if np.isnan(value) else f"{value:{spec}} {unit}".rstrip()


def run_page(run: str) -> str:
    """Return the page of a run, relative to the folder of the report.

    Examples
    --------
    >>> run_page("fake_object|run003")
    'runs/fake_object/run003.html'
    """
    return f"runs/{run.replace('|', '/')}.html"


def run_picture(run: str, png: bytes) -> Picture:
    """Return the picture of a run."""
    return picture(f"{run} seen from above", run, png)


def picture(alt: str, caption: str, png: bytes) -> Picture:
    """Return a PNG as an embedded picture."""
    pixels = int.from_bytes(png[16:20], "big")  # the width in a PNG's header
    return Picture(alt, caption, png_uri(png), round(pixels * 100 / DPI))


def png_uri(png: bytes) -> str:
    """Return a PNG as a data URI."""
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"
