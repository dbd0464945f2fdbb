"""Scenario files: YAML read under bounds, checked against ``scenario.schema.json``.

Each YAML document in a file is a scenario. Tags, anchors and aliases are refused, depth and size
are bounded, and plain scalars have the meaning of YAML 1.2's core schema. ``compilation`` checks
fields and expressions.
"""

import dataclasses
import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources.abc import Traversable
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, cast

import yaml

from oracle_pipeline.bags import json_schema
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Label
from sim.fuzzing.actuation import moves_something
from sim.fuzzing.schema_words import in_words, schema

Key = tuple[str | int, ...]  # path of a value in a document: ("transform", "actions", 0)
Control = Literal["none", "passthrough", "shadow"]

SET_PARAMETERS = "set_parameters"  # of nodes
WORLD = "/world"  # as a node: conditions of a simulated testbed, which no real system can set

MAX_BYTES = 2**18  # of a file
MAX_DEPTH = 24  # of a document
MAX_SCALAR = 4096  # characters
MAX_FAULTS = 20  # reported faults of a scenario

_INTEGER = re.compile(r"[-+]?[0-9]{1,18}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False}


class Location(NamedTuple):
    """Line and column in a file, counted from 1."""

    line: int = 1
    column: int = 1

    def __str__(self) -> str:
        return f"{self.line}:{self.column}"

    @classmethod
    def of(cls, mark: Any) -> "Location":
        """Return the place of YAML's mark."""
        return cls() if mark is None else cls(int(mark.line) + 1, int(mark.column) + 1)


NO_FILE: Mapping[Key, Location] = MappingProxyType(
    {(): Location()}
)  # of a document that is in none


class ScenarioError(OracleError):
    """A scenario is invalid; the text has a line for each fault, with place and key.

    The place is ``file:line:column``, as compilers write it and editors read it.

    Control characters are escaped.

    Parameters
    ----------
    text
        The faults.
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
        Path of its file.
    document
        The content of the file, as JSON values.
    places
        The place of each key.
    """

    file: str
    document: Mapping[str, Any]
    places: Mapping[Key, Location]

    @property
    def id(self) -> str:
        """Name of the scenario, and of the mode that it is."""
        return str(self.document["id"])

    @property
    def title(self) -> str:
        """Its purpose, in one line."""
        return str(self.document.get("title", self.id))

    @property
    def label(self) -> Label:
        """Label of its runs."""
        label: Label = self.document["label"]
        return label

    @property
    def seed(self) -> int:
        """Its part of the seed of all draws."""
        return int(self.document.get("seed", 0))

    @property
    def control(self) -> Control:
        """Whether altered messages are published."""
        control: Control = self.document.get("control", "none")
        return control

    @property
    def digest(self) -> str:
        """SHA-256 of the document's content, independent of its formatting."""
        return hashlib.sha256(json.dumps(self.document, sort_keys=True).encode()).hexdigest()

    @property
    def drawn(self) -> Mapping[str, str]:
        """Parameters whose value comes from the block: name -> what of the block."""
        parameters = self.document.get("parameters", {})
        return {name: spec["drawn"] for name, spec in parameters.items() if "drawn" in spec}

    @property
    def is_in_place(self) -> bool:
        """Whether messages are altered at their source, without a node."""
        main = self.document["main"]
        return bool(main["input"] == main["output"])

    @property
    def needs_simulator(self) -> bool:
        """Whether recordings cannot show its changes: of links, QoS or parameters of nodes."""
        links = any("to" in each or "qos" in each for each in self.altered.values())
        return SET_PARAMETERS in self.document or links

    @property
    def may_move(self) -> bool:
        """Whether it may move the robot or change its way, so that it needs permission."""
        spoken = (moves_something(*each) for each in self.spoken)
        settings = self.document.get(SET_PARAMETERS, ())
        return any(each["node"] != WORLD for each in settings) or any(spoken)

    @property
    def spoken(self) -> list[tuple[str, str]]:
        """All topics that it publishes on, with their types."""
        further = self.document.get("outputs", {}).values()
        return [
            *((each["output"], each["type"]) for each in self.altered.values()),
            *((each["topic"], each["type"]) for each in further),
        ]

    @property
    def altered(self) -> dict[Key, Mapping[str, Any]]:
        """Entries of the topics that it alters by their keys, the main one first."""
        further = self.document.get("also", {})
        entries: dict[Key, Mapping[str, Any]] = {("main",): self.document["main"]}
        return entries | {("also", name): entry for name, entry in further.items()}

    @property
    def has_object(self) -> bool:
        """Whether it shows the robot the fake object of the block."""
        return "object_x" in self.drawn.values()

    def as_shadow(self) -> "Scenario":
        """Return its shadow control: the same node and work, publishing the original."""
        changes = {
            "id": f"{self.id}_shadow",
            "title": f"{self.title}: worked out, and not sent",
            "label": "control",
            "control": "shadow",
        }
        return dataclasses.replace(self, document={**self.document, **changes})

    def on(self, testbed: str) -> "Scenario":
        """Return the scenario with the name of the testbed in which it is run."""
        return dataclasses.replace(self, document={**self.document, "testbed": testbed})

    def error(self, key: Key, text: str) -> ScenarioError:
        """Return an error with the place of a key in the file."""
        return _error(self.file, self.places, key, text)


def load_scenarios(path: Traversable) -> list[Scenario]:
    """Read a file of scenarios.

    Parameters
    ----------
    path : Path or other Traversable
        YAML, one scenario per document.

    Raises
    ------
    ScenarioError
        Naming file, line, key and expected value.
    """
    return parse_scenarios(_read(path), str(path))


def load_document(path: Path, rules: Mapping[str, Any]) -> dict[str, Any]:
    """Read another kind of file, as safely: one YAML document, checked by a JSON Schema.

    Raises
    ------
    ScenarioError
        As for ``load_scenarios``.
    """
    file = str(path)
    for document, places in _documents(_as_text(_read(path), file), file):
        if faults := _structure_faults(document, places, file, rules):
            raise together(faults)
        return cast(dict[str, Any], document)
    raise ScenarioError(f"{file}:1:1: expected a document, found an empty file.")


def _read(path: Traversable) -> bytes:
    """Return the content of a file, at most a byte more than a scenario file may have.

    Raises
    ------
    ScenarioError
        If it cannot be read.
    """
    try:
        if path.is_dir() or (isinstance(path, Path) and path.exists() and not path.is_file()):
            raise ScenarioError(f"{path}: expected a file, found a folder, a pipe or a device.")
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ScenarioError(f"Could not read {path}: {error}. Check the path.") from error


def parse_scenarios(data: bytes, file: str) -> list[Scenario]:
    """Return the scenarios in the text of a file; raises as ``load_scenarios`` does."""
    text = _as_text(data, file)
    scenarios: dict[str, Scenario] = {}
    faults: list[ScenarioError] = []
    for document, places in _documents(text, file):
        faults += _structure_faults(document, places, file, schema())
        if faults:
            continue
        scenario = Scenario(file, document, places)
        if scenario.id in scenarios:
            raise scenario.error(("id",), f"expected a new name, {scenario.id} stands above")
        scenarios[scenario.id] = scenario
    if faults:
        raise together(faults)
    if not scenarios:
        raise ScenarioError(f"{file}:1:1: expected a scenario, found an empty file.")
    return list(scenarios.values())


def _as_text(data: bytes, file: str) -> str:
    """Return the text of a file, within the bounds; raises as ``load_scenarios`` does."""
    if len(data) > MAX_BYTES:
        raise ScenarioError(f"{file}: expected at most {MAX_BYTES} bytes, found more.")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ScenarioError(
            f"{file}: expected text, found {error}. Give a YAML file in UTF-8."
        ) from error


def together(faults: Sequence[ScenarioError]) -> ScenarioError:
    """Return one error with a line for each of the first faults."""
    return ScenarioError("\n".join(map(str, faults[:MAX_FAULTS])))


def _error(file: str, places: Mapping[Key, Location], key: Key, text: str) -> ScenarioError:
    place = next(places[key[:n]] for n in range(len(key), -1, -1) if key[:n] in places)
    return ScenarioError(f"{file}:{place}: {_dotted(key)}: {text}.")


def _dotted(key: Key) -> str:
    """Return a key as text: ``transform.actions[0].do``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in key)
    return "".join(parts).removeprefix(".") or "(scenario)"


# YAML: events to plain data, without recursion, under bounds.


def _documents(text: str, file: str) -> Iterator[tuple[Any, dict[Key, Location]]]:
    """Yield each document with the places of its keys."""
    builder = _Builder(file)
    try:
        for event in yaml.parse(text, Loader=yaml.CSafeLoader):
            if isinstance(event, yaml.DocumentEndEvent):
                yield builder.root, builder.places
                builder = _Builder(file)
            elif isinstance(event, yaml.NodeEvent):
                builder.add(event)
            elif isinstance(event, yaml.CollectionEndEvent):
                builder.end()
    except yaml.MarkedYAMLError as error:
        place = Location.of(error.problem_mark)
        raise ScenarioError(f"{file}:{place}: expected YAML, {error.problem}.") from error
    except yaml.YAMLError as error:
        raise ScenarioError(f"{file}:1:1: expected YAML, found {error}.") from error


class _Builder:
    """Builds one document from its events."""

    def __init__(self, file: str) -> None:
        self.root: Any = None
        self.places: dict[Key, Location] = {}
        self._file = file
        self._open: list[tuple[Key, dict[str, Any] | list[Any]]] = []
        self._name: str | None = None  # of the value that comes next in a mapping

    def add(self, event: yaml.NodeEvent) -> None:
        """Take the beginning of a node."""
        place = Location.of(event.start_mark)
        self._refuse_references(event, place)
        if self._open and isinstance(self._open[-1][1], dict) and self._name is None:
            self._begin_entry(event, place)
            return
        key = self._place()
        self.places.setdefault(key, place)
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

    def _refuse_references(self, event: yaml.NodeEvent, place: Location) -> None:
        what = ""
        if isinstance(event, yaml.AliasEvent):
            what = f"the alias *{event.anchor}"
        elif event.anchor is not None:
            what = f"the anchor &{event.anchor}"
        elif getattr(event, "tag", None) is not None:
            what = f"the tag {getattr(event, 'tag', None)}"
        if what:
            raise ScenarioError(f"{self._file}:{place}: expected plain YAML, found {what[:80]}.")

    def _begin_entry(self, event: yaml.NodeEvent, place: Location) -> None:
        key, mapping = self._open[-1]
        if not isinstance(event, yaml.ScalarEvent) or len(event.value) > MAX_SCALAR:
            raise self._error(key, "expected names for keys")
        self.places[*key, event.value] = place
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
        return _error(self._file, self.places, key, text)


# JSON Schema: its faults as text.


def _structure_faults(
    document: Any, places: Mapping[Key, Location], file: str, rules: Mapping[str, Any]
) -> list[ScenarioError]:
    """Return the faults in the structure of a document."""
    found = sorted(
        json_schema.faults(document, rules),
        key=lambda error: (len(error.absolute_path), places[tuple(error.absolute_path)]),
    )
    errors = (_error(file, places, *words) for error in found for words in in_words(error))
    return list({str(error): error for error in errors}.values())[:MAX_FAULTS]
