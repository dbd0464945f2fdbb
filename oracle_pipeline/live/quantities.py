"""Options of commands that are sizes or times with a unit."""

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from oracle_pipeline.live.black_box import Keep
    from oracle_pipeline.live.split_bag import Split

_SIZES = {
    "B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30,
}  # fmt: skip
_TIMES = {"s": 1.0, "min": 60.0, "h": 3600.0}
_QUANTITY = re.compile(r"(\d+(?:\.\d+)?) ?([A-Za-z]+)")


def as_size(_ctx: click.Context, _param: click.Parameter, text: str | None) -> int | None:
    """Return the number of bytes that a text such as ``1GiB`` names."""
    if text is None:
        return None
    size = _quantity(text, _SIZES)
    if size is None:
        raise click.BadParameter(f"{text!r} is not a size; write it as 500MB or 1GiB.")
    return round(size)


def as_split(_ctx: click.Context, _param: click.Parameter, text: str | None) -> "Split":
    """Return the size or the length of a file that a text such as ``10min`` names."""
    from oracle_pipeline.live.split_bag import Split

    if text is None:
        return Split()
    size, seconds = _quantity(text, _SIZES), _quantity(text, _TIMES)
    if not size and not seconds:
        raise click.BadParameter(f"{text!r} is not a size or a time; write it as 1GiB or 10min.")
    return Split(round(size) if size else None, seconds)


def as_keep(_ctx: click.Context, _param: click.Parameter, text: str | None) -> "Keep | None":
    """Return the time before and after an alarm that a text such as ``60s+30s`` names."""
    from oracle_pipeline.live.black_box import Keep

    if text is None:
        return None
    times = [_quantity(each, _TIMES) for each in text.split("+")]
    if len(times) != 2 or times[0] is None or times[1] is None:
        raise click.BadParameter(
            f"{text!r} is not a time before and one after an alarm; write them as 60s+30s."
        )
    return Keep(times[0], times[1])


def _quantity(text: str, units: Mapping[str, float]) -> float | None:
    """Return a number with a unit in the base unit; None if it has no such unit."""
    found = _QUANTITY.fullmatch(text)
    return float(found[1]) * units[found[2]] if found and found[2] in units else None
