"""Units of the fields of common message types."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

ANGLE_NAMES = (
    "yaw", "roll", "pitch", "heading", "course", "bearing", "angle", "theta", "azimuth",
)  # fmt: skip


def of_fields(table: Path) -> dict[tuple[str, str], Any]:
    """Return a table of values by message type and field."""
    of_types: dict[str, dict[str, Any]] = yaml.safe_load(table.read_text("utf8"))
    return {(kind, name): of for kind, fields in of_types.items() for name, of in fields.items()}


UNITS: Mapping[tuple[str, str], str] = of_fields(Path(__file__).with_name("units.yaml"))


def period_of(name: str, unit: str, largest: float) -> float:
    """Return the period of an angle in its unit, 0 if a signal is not an angle.

    Parameters
    ----------
    name : str
        Of the signal, such as ``controller.yaw``.
    unit : str
        Empty if it is unknown.
    largest : float
        Largest magnitude of its values; radians beyond two turns are degrees.

    Examples
    --------
    >>> period_of("attitude.yaw", "", 170.0), period_of("twist.angular.z", "rad/s", 1.0)
    (360.0, 0.0)
    """
    last = name.rpartition(".")[2].partition("[")[0].lower()
    if unit not in ("", "rad", "deg") or not last.endswith(ANGLE_NAMES):
        return 0.0
    in_degrees = unit == "deg" or (not unit and largest > 4.0 * math.pi)
    return 360.0 if in_degrees else 2.0 * math.pi
