"""Finds all faults of a scenario file: of its YAML, its structure, its types and its expressions.

Compilation stops at the first stage that has faults, because later stages build on it. Here, faulty
parts are removed from a copy of the document, and the rest is checked again, until no more faults
are found. A reference to a removed part does not count as a fault.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from sim.fuzzing.compilation import compile_scenario
from sim.fuzzing.compile_context import OperationBudget
from sim.fuzzing.program import Program
from sim.fuzzing.scenario import (
    MAX_FAULTS,
    Key,
    Location,
    Scenario,
    ScenarioError,
    as_text,
    documents,
    read,
    structure_faults,
    together,
)

_STAND_INS: Mapping[str, Any] = {"schema": "mutant/v1", "id": "scenario", "label": "malicious"}
_VALUES: Mapping[str, Any] = {"float": 0.0, "int": 0, "bool": False, "string": ""}
MAX_BAD_LINES = 5  # lines that may be left out of invalid YAML
MAX_SLIPS = 20  # lines that are tried
_PREFIXES = {"parameters": "p", "constants": "c", "state": "state", "sources": "src"}
_ABSENT = "expected the key "  # prefix of faults that report a missing key
_EMPTY = "found null"  # suffix of such faults
_Document = tuple[Any, dict[Key, Location]]


def diagnose(path: Path, *, allow_actuation: bool = False) -> Iterator[Program | ScenarioError]:
    """Yield the program of each scenario in a file, or all of its faults.

    Parameters
    ----------
    path
        Of a scenario file.
    allow_actuation
        Whether scenarios may publish on topics that move something.
    """
    file = str(path)
    try:
        text = as_text(read(path), file)
    except ScenarioError as error:
        yield error
        return
    syntax, found = _read(text, file)
    if syntax:
        lines = syntax
        for document, places in found:
            lines += _faults(document, places, file, allow_actuation=allow_actuation, whole=False)
        yield together(lines)
        return
    if not found:
        yield ScenarioError(f"{file}:1:1: expected a scenario, found an empty file.")
    budget, known = OperationBudget(), set[str]()
    for document, places in found:
        faults = _faults(document, places, file, allow_actuation=allow_actuation)
        if not faults:
            scenario = Scenario(file, document, places)
            if scenario.id in known:
                text = f"expected a new name, {scenario.id} stands above"
                faults = [scenario.error(("id",), text)]
            known.add(scenario.id)
        if faults:
            yield together(faults)
            continue
        try:
            yield compile_scenario(scenario, allow_actuation=allow_actuation, budget=budget)
        except ScenarioError as error:  # the limit of the file
            yield error


def _read(text: str, file: str) -> tuple[list[ScenarioError], list[_Document]]:
    """Return the YAML faults of a text, and its documents without the invalid lines."""
    lines, faults = text.split("\n"), list[ScenarioError]()
    while len(faults) < MAX_BAD_LINES:
        try:
            return faults, list(documents("\n".join(lines), file))
        except ScenarioError as error:
            fault = error
        # The fault is in the line where YAML noticed it, or above.
        last = min(_place(fault).line, len(lines)) - 1
        slips = {number: slip for number, line in enumerate(lines) if (slip := _slip(line))}
        suspects = [
            n for n in (*[*slips][:MAX_SLIPS], last, last - 1) if n >= 0 and lines[n].strip()
        ]
        if not suspects:
            break
        worst = max(suspects, key=lambda n: _read_up_to(lines, n, file))
        if worst in slips:
            fault = ScenarioError(f"{file}:{Location(worst + 1)}: expected YAML, {slips[worst]}.")
        faults.append(fault)
        lines[worst] = ""
    return faults or [fault], []


def _read_up_to(lines: Sequence[str], without: int, file: str) -> int:
    """Return the line up to which a text is valid YAML if one line is left out."""
    rest = [*lines[:without], "", *lines[without + 1 :]]
    try:
        list(documents("\n".join(rest), file))
    except ScenarioError as error:
        return _place(error).line
    return len(lines) + 1


def _slip(line: str) -> str:
    """Return the probable fault of a line of YAML; empty if it is not obvious."""
    if "\t" in line[: len(line) - len(line.lstrip())]:
        return "found a tab in the indentation; use spaces"
    pairs = (line.count("{") - line.count("}"), line.count("[") - line.count("]"))
    if line.count('"') % 2 or any(pairs):
        return "found a quote or a bracket that is not closed"
    return ""


def _faults(
    document: Any,
    places: Mapping[Key, Location],
    file: str,
    *,
    allow_actuation: bool,
    whole: bool = True,
) -> list[ScenarioError]:
    """Return the faults of a document by line; no missing keys if lines were left out."""
    scenario = Scenario(file, document, places)
    found: dict[Key, list[str]] = {}
    structure: dict[Key, None] = {}
    for fault in structure_faults(document, dict(places), file):
        for key, text in fault.found:
            structure[key] = None
            if whole or not (text.startswith(_ABSENT) or text.endswith(_EMPTY)):
                found.setdefault(key, []).append(text)
    taken = _Taken(document)
    ready = all([taken.without(key) for key in structure])  # noqa: C419 -- all must be removed
    while ready and len(found) < MAX_FAULTS:
        before = taken.size
        rest, keys = taken.rest()
        try:
            compile_scenario(
                Scenario(file, rest, {new: places[old] for new, old in keys.items()}),
                allow_actuation=allow_actuation,
            )
            break
        except ScenarioError as error:
            ready = bool(error.found)
            for at, text in error.found:
                key = keys.get(at, at)
                if not taken.concerns(key) and text not in found.get(key, []):
                    found.setdefault(key, []).append(text)
                ready &= taken.without(key)
            ready &= taken.size > before  # else the next round would find the same
        except Exception:  # the rest may not be a scenario
            break
    errors = [scenario.error(key, text) for key, texts in found.items() for text in texts]
    return sorted(errors, key=_place)


def _place(error: ScenarioError) -> Location:
    """Return the place that a fault names."""
    place = re.search(r":(\d+):(\d+): ", str(error))
    return Location(int(place[1]), int(place[2])) if place else Location()


class _Taken:
    """A document whose faulty parts were removed or replaced by valid ones."""

    def __init__(self, document: Any) -> None:
        self._document = document
        self._out: set[Key] = set()
        self._instead: dict[Key, Any] = {}
        self._unknown: set[str] = set()  # patterns of names that are undefined now

    def without(self, key: Key) -> bool:
        """Remove a faulty part; return whether the rest can still be checked."""
        if not isinstance(self._document, dict):
            return False
        match key:
            case ():  # a required key is missing
                self._instead |= {(k,): v for k, v in _STAND_INS.items() if k not in self._document}
                return "main" in self._document
            case (str(name), *_) if name in _STAND_INS:
                self._instead[name,] = _STAND_INS[name]
            case ("main",) | ("main", "type"):
                return False
            case ("main", ("input" | "output") as end):
                self._instead[key] = f"/{end}"
            case ("main", *_):
                self._out.add(key)
            case ("parameters" | "state" as group, name, *_):
                self._value(group, str(name))
            case (("constants" | "sources") as group, name, *_):
                self._out.add((group, name))
                self._unknown.add(rf"\b{_PREFIXES[group]}\.{re.escape(str(name))}\b")
            case ("functions", name, *_):
                self._out.add((*key[:1], name))
                self._unknown.add(rf"\bfn\.{re.escape(str(name))}\b")
            case (("also" | "outputs") as group, name, *_):
                self._out.add((group, name))
                self._unknown.add(rf"\b{re.escape(str(name))}\b")
            case ("transform", *_):
                self._of_transform(key)
            case _:
                self._out.add(key)
        return True

    @property
    def size(self) -> int:
        """Number of removed parts."""
        return len(self._out) + len(self._instead) + len(self._unknown)

    def concerns(self, key: Key) -> bool:
        """Return whether a part refers to a removed one."""
        value = self._document
        for part in key:
            try:
                value = value[part]
            except (KeyError, IndexError, TypeError):
                break
        text = value if isinstance(value, str) else json.dumps(value)
        return any(re.search(pattern, text) for pattern in self._unknown)

    def rest(self) -> tuple[Any, dict[Key, Key]]:
        """Return the rest, and the place of each of its keys in the document."""
        keys: dict[Key, Key] = {}
        return self._copy(self._document, (), (), keys), keys

    def _value(self, group: str, name: str) -> None:
        """Replace a parameter or a value of the state by one of its type without bounds."""
        spec = self._document[group][name]
        kind = str(spec.get("type")) if isinstance(spec, dict) else ""
        if kind in _VALUES and (group, name) not in self._instead:
            self._instead[group, name] = {"type": kind, "default": _VALUES[kind]}
        else:
            self._instead.pop((group, name), None)
            self._out.add((group, name))
            self._unknown.add(rf"\b{_PREFIXES[group]}\.{re.escape(str(name))}\b")

    def _of_transform(self, key: Key) -> None:
        """Remove the operator that contains a fault, or else the smallest part around it."""
        match key:
            case (*_, "let", name) | (*_, "let", name, _):
                self._unknown.add(rf"\b{re.escape(str(name))}\b")
                self._out.add(key[: key.index("let") + 2])
            case ("transform", "actions", _, "name", *_):
                self._instead[key[:4]] = "action"
            case _ if "do" in key or key[1:2] == ("always",):
                at = len(key) - key[::-1].index("do") if "do" in key else 2
                self._out.add(key[: at + 1])
            case _:
                self._out.add(key[:4])

    def _copy(self, value: Any, old: Key, new: Key, keys: dict[Key, Key]) -> Any:
        keys[new] = old
        if old in self._instead:
            return self._instead[old]
        if isinstance(value, dict):
            copied = {
                name: self._copy(part, (*old, name), (*new, name), keys)
                for name, part in value.items()
                if (*old, name) not in self._out
            }
            stand_ins = {k[-1]: v for k, v in self._instead.items() if k[:-1] == old}
            return {**{str(k): v for k, v in stand_ins.items() if k not in value}, **copied}
        if isinstance(value, list):
            left = [place for place in range(len(value)) if (*old, place) not in self._out]
            return [
                self._copy(value[place], (*old, place), (*new, number), keys)
                for number, place in enumerate(left)
            ]
        return value
