"""The value in the expected unit of a number that may have been given in another unit."""

import math
import re
from collections.abc import Iterator

# The units of one quantity and their sizes. Of those below the first, the most usual comes first.
_QUANTITIES = (
    {"": 1.0, "%": 0.01},
    {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0},
    {"m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001, "km/h": 1 / 3.6},
    {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180},
    {"rad/s": 1.0, "deg/s": math.pi / 180, "°/s": math.pi / 180},
    {"s": 1.0, "ms": 0.001, "min": 60.0},
    {"Hz": 1.0, "kHz": 1000.0},
)
_QUANTITY = re.compile(r"\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*(\S+)\s*")


def readings(value: object, unit: str) -> Iterator[tuple[str, float]]:
    """Yield what a value may have been meant as, in words and as a number of a unit.

    Parameters
    ----------
    value
        A text such as ``5 cm``, which has one meaning; or a number, which may have been meant in
        each smaller unit.
    unit
        In which a number was expected; empty for a number without a unit.
    """
    sizes = next((known for known in _QUANTITIES if unit in known), {})
    match value:
        case str() if (found := _QUANTITY.fullmatch(value)) and found[2] in sizes:
            yield value.strip(), float(found[1]) * sizes[found[2]] / sizes[unit]
        case int() | float():
            for other, size in sizes.items():
                if size < sizes[unit]:
                    yield f"{value:g} {other}", float(value) * size / sizes[unit]
