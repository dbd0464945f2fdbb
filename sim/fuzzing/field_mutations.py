"""The changes of the ``mutate`` operator, which suit the type of a field.

The four kinds are those of RoboFuzz, after AFL: flip a bit, add a small number, insert a value that
often causes faults, insert a boundary of the type.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.fuzzing.fields import converter, difference, replaced
from sim.fuzzing.value_types import Array, Message, Number, Text, Type

_LARGEST_STEP = 35  # of arithmetic, as in AFL

_INTERESTING_WHOLE = (
    *(-128, -1, 0, 1, 16, 32, 64, 100, 127),
    *(-32768, -129, 128, 255, 256, 512, 1000, 1024, 4096, 32767),
    *(-(2**31), -100663046, -32769, 32768, 65535, 65536, 100663045, 2**31 - 1),
)
_INTERESTING_REAL = (0.0, -0.0, 1.0, -1.0, 0.5, 1e-6, 1e6, -1e6, math.pi, -math.pi, math.nan)
_INTERESTING_TEXT = ("", " ", "0", "-1", "nan", "null", "%s%n", "../..", "map", "/", "ä", "'")

_Way = tuple[str | None, ...]  # to a value: names of fields, None for an element of an array


@dataclass(frozen=True, slots=True)
class FieldMutator:
    """Changes one value of a message.

    Parameters
    ----------
    leaves
        The ways to all values that may be changed, and their types.
    mutations
        Names of the kinds of change that may be made.
    """

    leaves: tuple[tuple[_Way, Type], ...]
    mutations: tuple[str, ...]

    @classmethod
    def of(cls, root: Message, fields: Sequence[str], mutations: Sequence[str]) -> "FieldMutator":
        """Return the mutator of a message type.

        Parameters
        ----------
        root
            The message type.
        fields
            Paths of fields; only these and what is in them are changed. Empty: everything.
        mutations
            Names of kinds.
        """
        prefixes = [tuple(path.split(".")) for path in fields] or [()]
        leaves = (
            (way, kind)
            for way, kind in _leaves(root)
            if any(way[: len(prefix)] == prefix for prefix in prefixes)
        )
        return cls(tuple(leaves), tuple(mutations))

    def __call__(self, message: Any, rng: np.random.Generator) -> tuple[Any, float, str]:
        """Return a mutant, the size of its difference, and a description of the change.

        A message without anything to change, since all of its sequences are empty, is returned
        unchanged.
        """
        for number in rng.permutation(len(self.leaves)):
            leaf, kind = self.leaves[number]
            way, old = _pick(message, leaf, rng)
            if way is None:
                continue
            name = self.mutations[rng.integers(len(self.mutations))]
            new = MUTATIONS[name](old, kind, rng)
            path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in way)
            amount, text = difference(path.removeprefix("."), old, new)
            return replaced(message, way, new), amount, f"{name} {text}"
        return message, 0.0, "nothing to mutate"


def _leaves(kind: Type, way: _Way = ()) -> Iterator[tuple[_Way, Type]]:
    match kind:
        case Message():
            for name, inner in kind.fields.items():
                yield from _leaves(inner, (*way, name))
        case Array():
            yield from _leaves(kind.element, (*way, None))
        case _:
            yield way, kind


def _pick(
    message: Any, leaf: _Way, rng: np.random.Generator
) -> tuple[tuple[str | int, ...] | None, Any]:
    """Draw one of the numbers in a leaf; None if it has none."""
    way: list[str | int] = []
    value = message
    for part in leaf:
        if part is not None:
            way.append(part)
            value = getattr(value, part)
        elif len(value) == 0:
            return None, None
        else:
            way.append(int(rng.integers(len(value))))
            value = value[way[-1]]
    return tuple(way), value.item() if isinstance(value, np.generic) else value


def _bit_flip(old: Any, kind: Type, rng: np.random.Generator) -> Any:
    match kind:
        case Number(name):
            bits = np.array([old], name).view(f"u{np.dtype(name).itemsize}")
            bits ^= bits.dtype.type(1 << int(rng.integers(bits.itemsize * 8)))
            return bits.view(name)[0].item()
        case Text():
            return _with_character(old, rng, lambda code: code ^ 1 << int(rng.integers(7)))
    return not old


def _arithmetic(old: Any, kind: Type, rng: np.random.Generator) -> Any:
    step = int(rng.integers(1, _LARGEST_STEP + 1)) * (1 if rng.random() < 0.5 else -1)
    match kind:
        case Number():
            return converter(kind)(old + step, old)
        case Text():
            return _with_character(old, rng, lambda code: (code + step) % 128)
    return not old


def _interesting(old: Any, kind: Type, rng: np.random.Generator) -> Any:
    match kind:
        case Number(name) if kind.is_integer:
            limits = np.iinfo(name)
            values = [v for v in _INTERESTING_WHOLE if limits.min <= v <= limits.max]
            return _another(values, old, rng)
        case Number():
            return _another([converter(kind)(v, old) for v in _INTERESTING_REAL], old, rng)
        case Text(max_len):
            return _another([v[:max_len] for v in _INTERESTING_TEXT], old, rng)
    return not old


def _boundary(old: Any, kind: Type, rng: np.random.Generator) -> Any:
    match kind:
        case Number(name) if kind.is_integer:
            whole = np.iinfo(name)
            low, high = int(whole.min), int(whole.max)
            return _another([low, low + 1, 0, high - 1, high], old, rng)
        case Number(name):
            real = np.finfo(name)
            ends = [float(v) for v in (real.max, real.tiny, real.smallest_subnormal)]
            return _another([*ends, *(-v for v in ends), 0.0, math.inf, -math.inf], old, rng)
        case Text(max_len):
            return _another(["", "A", "A" * max_len], old, rng)
    return not old


MUTATIONS: Mapping[str, Callable[[Any, Type, np.random.Generator], Any]] = {
    "bit_flip": _bit_flip,
    "arithmetic": _arithmetic,
    "interesting": _interesting,
    "boundary": _boundary,
}


def _another(values: Sequence[Any], old: Any, rng: np.random.Generator) -> Any:
    others = [value for value in values if value != old]
    return others[rng.integers(len(others))]


def _with_character(old: str, rng: np.random.Generator, change: Callable[[int], int]) -> str:
    """Change one character; an empty text gets one."""
    if not old:
        return chr(change(0))
    place = int(rng.integers(len(old)))
    code = ord(old[place])
    # Outside ASCII only the lower seven bits change, so that it stays a character.
    return f"{old[:place]}{chr(code & ~127 | change(code & 127) & 127)}{old[place + 1 :]}"
