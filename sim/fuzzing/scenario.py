"""Scenario files: YAML read under bounds, checked against ``scenario.schema.json``.

A file holds one scenario a document. Tags, anchors and aliases are refused, depth and size are
bounded, and plain scalars mean what YAML 1.2's core schema says. What the scenario says of fields
and expressions is checked in ``sim.fuzzing.program``.
"""

import dataclasses
import functools
import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Literal, cast

import jsonschema
import yaml

from oracle_pipeline.bags import json_schema
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Label

Key = tuple[str | int, ...]  # where something stands in a document: ("transform", "actions", 0)
Control = Literal["none", "passthrough", "shadow"]

MAX_BYTES = 2**18  # of a file
MAX_DEPTH = 24  # of a document
MAX_SCALAR = 4096  # characters
MAX_FAULTS = 20  # that are told of a file

_INTEGER = re.compile(r"[-+]?[0-9]{1,18}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False}


class ScenarioError(OracleError):
    """A scenario is refused; the text begins with file, line and key, a line for each fault.

    Characters that a terminal would obey, or a log could not write, are shown by their codes.
    """

    def __init__(self, text: str) -> None:
        super().__init__("".join(map(_shown_character, text)))


def _shown_character(character: str) -> str:
    if character == "\n" or character.isprintable():
        return character
    return character.encode("unicode_escape").decode("ascii")


@dataclasses.dataclass(frozen=True, slots=True)
class Scenario:
    """One checked document.

    Parameters
    ----------
    file
        Where it comes from.
    document
        What the file says, as JSON knows it.
    lines
        The line of each key, counted from 1.
    """

    file: str
    document: Mapping[str, Any]
    lines: Mapping[Key, int]

    @property
    def id(self) -> str:
        """Name of the scenario, and of the mode that it is."""
        return str(self.document["id"])

    @property
    def title(self) -> str:
        """What it does, in a line."""
        return str(self.document.get("title", self.id))

    @property
    def label(self) -> Label:
        """How its runs are labelled."""
        label: Label = self.document["label"]
        return label

    @property
    def seed(self) -> int:
        """Its part of the key of all draws."""
        return int(self.document.get("seed", 0))

    @property
    def control(self) -> Control:
        """Whether what is worked out is published."""
        control: Control = self.document.get("control", "none")
        return control

    @property
    def digest(self) -> str:
        """SHA-256 of the document, whatever its layout."""
        return hashlib.sha256(json.dumps(self.document, sort_keys=True).encode()).hexdigest()

    @property
    def drawn(self) -> Mapping[str, str]:
        """Parameters whose value comes from the block: name -> what of the block."""
        parameters = self.document.get("parameters", {})
        return {name: spec["drawn"] for name, spec in parameters.items() if "drawn" in spec}

    @property
    def has_object(self) -> bool:
        """Whether it shows the robot the block's object that is not there."""
        return "object_x" in self.drawn.values()

    def as_shadow(self) -> "Scenario":
        """Return its control: the same node doing the same work, publishing the original."""
        changes = {
            "id": f"{self.id}_shadow",
            "title": f"{self.title}: worked out, and not sent",
            "label": "control",
            "control": "shadow",
        }
        return dataclasses.replace(self, document={**self.document, **changes})

    def error(self, key: Key, text: str) -> ScenarioError:
        """Return the error that says where in the file something is wrong."""
        return _error(self.file, self.lines, key, text)


def load_scenarios(path: Traversable) -> list[Scenario]:
    """Read a file of scenarios.

    Parameters
    ----------
    path : Path or other Traversable
        YAML, one scenario a document.

    Raises
    ------
    ScenarioError
        Naming file, line and key, and what was expected there.
    """
    try:
        if path.is_dir() or (isinstance(path, Path) and path.exists() and not path.is_file()):
            raise ScenarioError(f"{path}: expected a file, found a folder, a pipe or a device.")
        with path.open("rb") as file:  # no more of it than is looked at
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ScenarioError(f"Could not read {path}: {error}. Check the path.") from error
    return parse_scenarios(data, str(path))


def parse_scenarios(data: bytes, file: str) -> list[Scenario]:
    """Return the scenarios in the text of a file; raises as ``load_scenarios`` does."""
    if len(data) > MAX_BYTES:
        raise ScenarioError(f"{file}: expected at most {MAX_BYTES} bytes, found more.")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ScenarioError(
            f"{file}: expected text, found {error}. Give a YAML file in UTF-8."
        ) from error
    scenarios: dict[str, Scenario] = {}
    faults: list[str] = []
    for document, lines in _documents(text, file):
        faults += _faults(document, lines, file)
        if faults:
            continue
        scenario = Scenario(file, document, lines)
        if scenario.id in scenarios:
            raise scenario.error(("id",), f"expected a new name, {scenario.id} stands above")
        scenarios[scenario.id] = scenario
    if faults:
        raise ScenarioError("\n".join(faults[:MAX_FAULTS]))
    if not scenarios:
        raise ScenarioError(f"{file}:1: expected a scenario, found an empty file.")
    return list(scenarios.values())


@functools.cache
def schema() -> dict[str, Any]:
    """Return the JSON Schema of a scenario."""
    text = files(__package__).joinpath("scenario.schema.json").read_text("utf-8")
    document: dict[str, Any] = json.loads(text)
    return document


def _error(file: str, lines: Mapping[Key, int], key: Key, text: str) -> ScenarioError:
    line = next(lines[key[:n]] for n in range(len(key), -1, -1) if key[:n] in lines)
    return ScenarioError(f"{file}:{line}: {_dotted(key)}: {text}.")


def _dotted(key: Key) -> str:
    """Return a key as people write it: ``transform.actions[0].do``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in key)
    return "".join(parts).removeprefix(".") or "(scenario)"


# YAML: events to plain data, without recursion, under bounds.


def _documents(text: str, file: str) -> Iterator[tuple[Any, dict[Key, int]]]:
    """Yield each document with the lines of its keys."""
    builder = _Builder(file)
    try:
        for event in yaml.parse(text, Loader=yaml.CSafeLoader):
            if isinstance(event, yaml.DocumentEndEvent):
                yield builder.root, builder.lines
                builder = _Builder(file)
            elif isinstance(event, yaml.NodeEvent):
                builder.add(event)
            elif isinstance(event, yaml.CollectionEndEvent):
                builder.end()
    except yaml.MarkedYAMLError as error:
        line = _line(error.problem_mark)
        raise ScenarioError(f"{file}:{line}: expected YAML, {error.problem}.") from error
    except yaml.YAMLError as error:
        raise ScenarioError(f"{file}:1: expected YAML, found {error}.") from error


def _line(mark: Any) -> int:
    return 1 if mark is None else int(mark.line) + 1


class _Builder:
    """One document as its events come."""

    def __init__(self, file: str) -> None:
        self.root: Any = None
        self.lines: dict[Key, int] = {}
        self._file = file
        self._open: list[tuple[Key, dict[str, Any] | list[Any]]] = []
        self._name: str | None = None  # of the value that comes next in a mapping

    def add(self, event: yaml.NodeEvent) -> None:
        """Take the beginning of a node."""
        line = _line(event.start_mark)
        self._refuse_references(event, line)
        if self._open and isinstance(self._open[-1][1], dict) and self._name is None:
            self._begin_entry(event, line)
            return
        key = self._place()
        self.lines.setdefault(key, line)
        if isinstance(event, yaml.ScalarEvent):
            self._put(self._scalar(event, key))
            return
        value: dict[str, Any] | list[Any]
        value = {} if isinstance(event, yaml.MappingStartEvent) else []
        self._put(value)
        self._open.append((key, value))
        if len(self._open) > MAX_DEPTH:
            raise self._error(key, f"expected at most {MAX_DEPTH} levels")

    def end(self) -> None:
        """Take the end of a mapping or a list."""
        self._open.pop()

    def _refuse_references(self, event: yaml.NodeEvent, line: int) -> None:
        what = ""
        if isinstance(event, yaml.AliasEvent):
            what = f"the alias *{event.anchor}"
        elif event.anchor is not None:
            what = f"the anchor &{event.anchor}"
        elif getattr(event, "tag", None) is not None:
            what = f"the tag {getattr(event, 'tag', None)}"
        if what:
            raise ScenarioError(f"{self._file}:{line}: expected plain YAML, found {what[:80]}.")

    def _begin_entry(self, event: yaml.NodeEvent, line: int) -> None:
        key, mapping = self._open[-1]
        if not isinstance(event, yaml.ScalarEvent) or len(event.value) > MAX_SCALAR:
            raise self._error(key, "expected names for keys")
        self.lines[*key, event.value] = line
        if event.value in mapping:
            raise self._error((*key, event.value), "expected each key once")
        self._name = event.value

    def _place(self) -> Key:
        """Return the key of the node that comes next."""
        if not self._open:
            return ()
        key, container = self._open[-1]
        return (*key, len(container) if self._name is None else self._name)

    def _put(self, value: Any) -> None:
        if not self._open:
            self.root = value
            return
        _, container = self._open[-1]
        if isinstance(container, list):
            container.append(value)
        elif self._name is not None:
            container[self._name] = value
            self._name = None

    def _scalar(self, event: yaml.ScalarEvent, key: Key) -> Any:
        text = event.value
        if len(text) > MAX_SCALAR:
            raise self._error(key, f"expected at most {MAX_SCALAR} characters, found {len(text)}")
        if not event.implicit[0]:  # it is quoted
            return text
        if text in _WORDS:
            return _WORDS[text]
        if _INTEGER.fullmatch(text):
            return int(text)
        if _FLOAT.fullmatch(text):
            number = float(text)
            if math.isinf(number):
                raise self._error(key, f"expected a number of 64 bits, found {text[:40]}")
            return number
        return text

    def _error(self, key: Key, text: str) -> ScenarioError:
        return _error(self._file, self.lines, key, text)


# JSON Schema: its findings in words.


def _faults(document: Any, lines: dict[Key, int], file: str) -> list[str]:
    """Return what is wrong with a document, what comes first in it before the rest."""
    found = sorted(
        json_schema.faults(document, schema()),
        key=lambda error: (len(error.absolute_path), lines[tuple(error.absolute_path)]),
    )
    told = (_error(file, lines, *words) for error in found for words in _in_words(error))
    return list(itertools.islice(dict.fromkeys(map(str, told)), MAX_FAULTS))


def _in_words(error: jsonschema.ValidationError) -> Iterator[tuple[Key, str]]:
    """Yield where it went wrong and what was expected there."""
    key: Key = tuple(error.absolute_path)
    rule, value = error.validator, cast(Any, error.validator_value)
    instance, rules = cast(Any, error.instance), cast(dict[str, Any], error.schema)
    found = f"found {_shown(instance)}"
    match rule:
        case "type":
            kinds = [value] if isinstance(value, str) else value
            yield key, f"expected {' or '.join(_KINDS[kind] for kind in kinds)}, {found}"
        case "const":
            yield key, f"expected {value}, {found}"
        case "enum":
            yield key, f"expected one of {', '.join(value)}, {found}"
        case "required":
            yield from ((key, f"expected the key {n}") for n in value if n not in instance)
        case "additionalProperties":
            known = list(rules.get("properties", ()))
            there = f"expected one of {', '.join(known)}" if known else "expected nothing"
            for unknown in (name for name in instance if name not in known):
                yield (*key, unknown), f"{there}, found {_shown(unknown)}"
        case "pattern":
            yield key, f"expected {_PATTERNS[value]}, {found}"
        case "minProperties" | "minItems" | "minLength":
            yield key, f"expected at least {value}, {found}"
        case "maxProperties" | "maxItems" | "maxLength":
            yield key, f"expected at most {value}, found {len(instance)}"
        case "uniqueItems":
            yield key, f"expected each value once, {found}"
        case "minimum":
            yield key, f"expected at least {value}, {found}"
        case "exclusiveMinimum":
            yield key, f"expected more than {value}, {found}"
        case "maximum":
            yield key, f"expected at most {value}, {found}"
        case _:
            yield key, f"expected otherwise: {error.message[:200]}"


_KINDS = {
    "object": "a mapping",
    "array": "a list",
    "string": "a text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
}

_PATTERNS = {
    schema()["$defs"][name]["pattern"]: words
    for name, words in {
        "name": "a name such as random_noise",
        "topic": "a full topic name such as /scan_tom",
        "message_type": "a message type such as sensor_msgs/msg/LaserScan",
        "field": "a field such as pose.pose.position.x",
    }.items()
}


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
