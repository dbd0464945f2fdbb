"""Requirements in signal temporal logic: read from YAML, and evaluated on a trace.

::

    requirements:
      - name: clearance_above_footprint
        says: No obstacle comes nearer than the radius of the robot.   # optional
        formula: always (nearest_min >= 0.22)
        scale: 0.05     # a difference that matters, in the unit of the formula
    signals:            # optional
      voltage: /battery_state/voltage   # any number in the messages: topic, field

A key ``learned_from`` lists the recordings that the formulas were learned from, by
`TracedRuns.digests`: they cannot show how often a normal run breaks a formula.

A formula is text for the parser of SENTIL [1]_, never code. Its names are signals of every robot
(``traces.SIGNALS``), which are found by role, and those that the file names. The robustness of a
formula is the margin by which it holds; it is negative if the formula is violated [2]_.

References
----------
.. [1] https://pypi.org/project/sentil/
.. [2] G. Fainekos, G. Pappas, "Robustness of temporal logic specifications for continuous-time
   signals", Theoretical Computer Science 410, 2009.
"""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import sentil
import yaml
from numpy.typing import NDArray

from oracle_pipeline.bags import bounded_yaml
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.oracles.traces import NO_NUMBERS, SIGNALS, TIME, known_names, values_of

NAV2 = Path(__file__).with_name("nav2.yaml")
FARTHEST = 1e6  # limit of a robustness [scales]

_REQUIREMENTS, _SIGNALS, _LEARNED_FROM = "requirements", "signals", "learned_from"
_KEYS = ("name", "formula", "scale", "says")
_LARGEST = 8 * 1024 * 1024  # bytes; invariants of 4,096 signals have half of that
_NAME = re.compile(r"[A-Za-z_]\w*")


class RequirementError(OracleError):
    """A file of requirements cannot be used."""


@dataclass(frozen=True, slots=True)
class Requirement:
    """One formula that every run should satisfy."""

    name: str
    formula: str
    scale: float = 1.0
    says: str = ""


class Requirements(list[Requirement]):
    """The content of a file.

    Attributes
    ----------
    signals : mapping of str to str
        Further signals of the formulas, and the number in messages that each is.
    learned_from : frozenset of str
        The recordings that the formulas were learned from.
    """

    signals: Mapping[str, str] = NO_NUMBERS
    learned_from: frozenset[str] = frozenset()


def load(path: Path) -> Requirements:
    """Read a file of requirements.

    Raises
    ------
    RequirementError
        The file is invalid; the message has file, line and fault.
    """
    try:
        with path.open("rb") as source:
            content = source.read(_LARGEST + 1)
        if len(content) > _LARGEST:
            raise ValueError(f"it is larger than {_LARGEST} bytes")
        text = content.decode()
        document = bounded_yaml.load(text)
        if not isinstance(document, dict) or list(document)[:1] != [_REQUIREMENTS]:
            raise ValueError(f"it must be a mapping with {_REQUIREMENTS!r} as its first key")
        if unknown := set(document) - {_REQUIREMENTS, _SIGNALS, _LEARNED_FROM}:
            raise ValueError(f"unknown key {unknown.pop()!r}")
        own = _named(document.pop(_SIGNALS, {}))
        if not all(isinstance(value, list) for value in document.values()):
            raise ValueError(f"{' and '.join(map(repr, document))} must be a list")
    except (ValueError, OSError) as error:
        raise RequirementError(f"{path} is not a file of requirements: {error}.") from error
    read = Requirements()
    read.signals = own
    read.learned_from = frozenset(map(str, document.get(_LEARNED_FROM, [])))
    for line, given in zip(_lines(text), document[_REQUIREMENTS], strict=True):
        try:
            requirement = _requirement(given, own)
            if any(requirement.name == other.name for other in read):
                raise ValueError(f"the name {requirement.name!r} is used twice")
        except ValueError as error:
            raise RequirementError(f"{path}, line {line}: {error}.") from error
        read.append(requirement)
    return read


def dump(
    requirements: Iterable[Requirement],
    head: str,
    learned_from: Iterable[str] = (),
    signals: Mapping[str, str] = NO_NUMBERS,
) -> str:
    """Return requirements as YAML, one per line, below a comment."""
    lines = [*(f"# {line}" for line in head.splitlines()), f"{_REQUIREMENTS}:"]
    for each in requirements:
        given = {"name": each.name, "formula": each.formula, "scale": each.scale}
        given |= {"says": each.says} if each.says else {}
        text = yaml.safe_dump(given, default_flow_style=True, sort_keys=False, width=10_000)
        lines.append(f"  - {text.strip()}")
    named = [f"  {name}: {number!r}" for name, number in signals.items()]
    lines += [f"{_SIGNALS}:", *named] if named else []
    known = [f"  - '{digest}'" for digest in learned_from]
    lines += [f"{_LEARNED_FROM}:", *known] if known else []
    return "\n".join(lines) + "\n"


def violations(requirements: Sequence[Requirement], trace: pd.DataFrame) -> NDArray[np.float64]:
    """Return the violation of each requirement by a trace, in scales; negative if it holds.

    Returns
    -------
    ndarray of shape (n_requirements,)
        NaN where the trace lacks a signal of the formula.
    """
    robustness = [_robustness(sentil.Formula.parse(each.formula), trace) for each in requirements]
    scales = np.array([each.scale for each in requirements])
    beyond = np.clip(-np.array(robustness, dtype=np.float64) / scales, -FARTHEST, FARTHEST)
    return np.asarray(beyond, dtype=np.float64)


def _robustness(formula: Any, trace: pd.DataFrame) -> float:
    """Return the robustness at the first sample; samples that lack a signal are skipped."""
    names = formula.variables
    values = values_of(trace, names)
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        return np.nan
    seen = dict(zip(names, values[known].T, strict=True))
    return float(formula.robustness(sentil.Trace(trace[TIME].to_numpy()[known], seen)))


def _named(given: Any) -> dict[str, str]:
    """Check the further signals of a file."""
    if not isinstance(given, dict):
        raise ValueError(f"{_SIGNALS!r} must be a mapping of names to numbers in messages")
    for name, number in given.items():
        if not (isinstance(name, str) and _NAME.fullmatch(name)) or name in known_names():
            raise ValueError(f"{name!r} cannot name a signal: use letters and _, and another name")
        if not (isinstance(number, str) and number.startswith("/") and number.count("/") > 1):
            raise ValueError(f"signal {name!r} must be a topic and a field: /battery_state/voltage")
    return given


def _requirement(given: Any, own: Mapping[str, str]) -> Requirement:
    if not isinstance(given, dict):
        raise ValueError(f"a requirement is a mapping of {', '.join(_KEYS)}")
    if unknown := [str(key) for key in given if key not in _KEYS]:
        raise ValueError(f"unknown key {unknown[0]!r}; known are {', '.join(_KEYS)}")
    texts = {key: given.get(key, "") for key in ("name", "formula", "says")}
    for key, text in texts.items():
        if not isinstance(text, str) or (key != "says" and not text.strip()):
            raise ValueError(f"{key!r} must be a string")
    scale = given.get("scale", 1.0)
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0.0 < scale < np.inf:
        raise ValueError(f"'scale' must be a number above 0, found {scale!r}")
    _check(texts["formula"], own)
    return Requirement(texts["name"], texts["formula"], float(scale), texts["says"])


def _check(formula: str, own: Mapping[str, str]) -> None:
    """Raise an error for a formula that cannot be parsed or evaluated, or has no signal."""
    try:
        parsed = sentil.Formula.parse(formula)
    except sentil.SentilError as error:
        raise ValueError(f"{formula!r} is not a formula: {error}") from error
    if not parsed.variables:
        raise ValueError(f"{formula!r} has no signal")
    for name in parsed.variables:
        if name not in (known := known_names(own)):
            close = difflib.get_close_matches(name, known, 1)
            hint = f"; did you mean {close[0]}?" if close else f"; known are {', '.join(SIGNALS)}"
            raise ValueError(f"there is no signal {name!r}{hint}")
    try:
        still: dict[str, object] = {name: np.zeros(2) for name in parsed.variables}
        parsed.robustness(sentil.Trace([0.0, 1.0], still))
    except sentil.SentilError as error:
        raise ValueError(f"{formula!r} cannot be evaluated: {error}") from error


def _lines(text: str) -> list[int]:
    """Return the line on which each requirement begins; the text has been checked."""
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(root, yaml.MappingNode)  # noqa: S101 -- checked by the caller
    return [node.start_mark.line + 1 for node in root.value[0][1].value]
