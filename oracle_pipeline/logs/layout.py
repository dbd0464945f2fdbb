"""The layout file of tables: a small YAML that names time, units and topics.

::

    recording: folder              # its files are topics; with `file`, each file is a recording
    topics:
      - file: imu*.csv
        topic: /imu
        type: sensor_msgs/msg/Imu  # optional; without it, each column is a field
        time: {column: Time, unit: s}          # or {rate: 100}: rows a second
        fields:                    # optional; by default, each column has its own name
          angular_velocity.z: {column: gz, unit: deg/s}
        ignore: [comment]

It is called ``oracle_log.yaml`` and is beside the tables or in the folder above. What it leaves out
is guessed, and a note says so.
"""

import functools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from importlib.resources import files
from pathlib import Path
from typing import Any, Self

import yaml

from oracle_pipeline.bags import bounded_yaml
from oracle_pipeline.bags.json_schema import faults
from oracle_pipeline.bags.types import typestore
from oracle_pipeline.logs.log import LogError

LAYOUT_FILE = "oracle_log.yaml"

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

# What one of a unit is in that of REP 103, which ROS types have.
_FACTORS = {
    "": 1.0, "1": 1.0, "m": 1.0, "m/s": 1.0, "m/s^2": 1.0, "rad": 1.0, "rad/s": 1.0, "s": 1.0,
    "N": 1.0, "N*m": 1.0, "V": 1.0, "A": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "km/h": 1 / 3.6,
    "deg": math.pi / 180, "deg/s": math.pi / 180, "g": 9.80665, "mV": 1e-3, "mA": 1e-3, "ms": 1e-3,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TopicLayout:
    """How one table becomes the messages of one topic; empty values are guessed."""

    file: str = "*"  # a glob over names of files
    topic: str = ""
    msgtype: str = ""
    time_column: str = ""
    time_unit: str = ""
    rate_hz: float = 0.0  # rows a second, of tables without a column of time
    columns: Mapping[str, str] = field(default_factory=dict)  # by field
    units: Mapping[str, str] = field(default_factory=dict)  # by field
    ignore: tuple[str, ...] = ()

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Self:
        """Return the layout from an entry of the file."""
        time = document.get("time", {})
        given = {
            name: {"column": about} if isinstance(about, str) else about
            for name, about in document.get("fields", {}).items()
        }
        return cls(
            document["file"], document.get("topic", ""), document.get("type", ""),
            time.get("column", ""), time.get("unit", ""), float(time.get("rate", 0.0)),
            {name: about["column"] for name, about in given.items()},
            {name: about["unit"] for name, about in given.items() if "unit" in about},
            tuple(document.get("ignore", ())),
        )  # fmt: skip

    def document(self) -> dict[str, Any]:
        """Return the entry of the file, without what is empty."""
        time: dict[str, Any] = {"column": self.time_column, "unit": self.time_unit}
        if self.rate_hz:
            time = {"rate": self.rate_hz}
        entry = {
            "file": self.file, "topic": self.topic, "type": self.msgtype, "time": time,
            "fields": dict(self.columns), "ignore": list(self.ignore),
        }  # fmt: skip
        return {key: value for key, value in entry.items() if value}


@dataclass(frozen=True, slots=True)
class Layout:
    """The content of a layout file.

    Attributes
    ----------
    recording : {"", "file", "folder"}
        Whether a file or a folder is one recording; empty: it is guessed.
    topics : tuple of TopicLayout
        The first whose glob matches a file's name counts.
    """

    recording: str = ""
    topics: tuple[TopicLayout, ...] = ()

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a layout file.

        Raises
        ------
        LogError
            It is no valid layout; the message has the first fault.
        """
        try:
            document = bounded_yaml.load(path.read_text("utf-8"))
        except (ValueError, OSError) as error:
            raise LogError(f"{path} is not a layout file: {error}.") from error
        if found := faults(document, _schema()):
            fault = found[0]
            raise LogError(f"{path} is not a layout file: {fault.json_path}: {fault.message}.")
        layout = cls(
            document.get("recording", ""),
            tuple(TopicLayout.of(entry) for entry in document.get("topics", ())),
        )
        for topic in layout.topics:
            if topic.msgtype and topic.msgtype not in typestore().fielddefs:
                raise LogError(f"{path} names the type {topic.msgtype}, which is not known.")
            for unit in topic.units.values():
                if topic.msgtype and unit not in _FACTORS:
                    known = ", ".join(filter(None, _FACTORS))
                    raise LogError(f"{path} names the unit {unit!r}; known are {known}.")
        return layout

    def of_file(self, name: str) -> TopicLayout:
        """Return the layout of a file."""
        return next((t for t in self.topics if fnmatchcase(name, t.file)), TopicLayout(name))

    def text(self) -> str:
        """Return the layout as YAML."""
        document = {"recording": self.recording, "topics": [t.document() for t in self.topics]}
        return str(yaml.safe_dump({k: v for k, v in document.items() if v}, sort_keys=False))


def find_layout(path: Path) -> Layout:
    """Return the layout beside a log, or in the folder above it; an empty one without a file."""
    folder = path if path.is_dir() else path.parent
    for place in (folder, folder.parent):
        if (file := place / LAYOUT_FILE).is_file():
            return Layout.load(file)
    return Layout()


def factor(unit: str) -> float:
    """Return what a number in a unit is multiplied with, to be in the unit of REP 103."""
    return _FACTORS[unit]


@functools.cache
def _schema() -> Any:
    return json.loads(files(__package__).joinpath("layout.schema.json").read_text("utf-8"))
