"""Helpers for all pages of the report: templates and embedded pictures."""

import base64
import functools
from typing import NamedTuple

import jinja2

from oracle_pipeline.reporting.figures import DPI


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
    return environment.get_template(name)


def run_picture(run: str, png: bytes) -> Picture:
    """Return the picture of a run."""
    return picture(f"{run} seen from above", run, png)


def picture(alt: str, caption: str, png: bytes) -> Picture:
    """Return a PNG as an embedded picture."""
    pixels = int.from_bytes(png[16:20], "big")  # the width in a PNG's header
    uri = f"data:image/png;base64,{base64.b64encode(png).decode()}"
    return Picture(alt, caption, uri, round(pixels * 100 / DPI))
