"""Feature plugins in shared libraries, each in its own process.

The interface is ``oracle_plugin.h`` beside this module. The process gets tables as Arrow files and
passes them to the library through the Arrow C data interface. If the library crashes, only its own
features of that recording are lost.
"""

import json
import math
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oracle_pipeline.features.engine.plugin import (
    Feature,
    FeaturePlugin,
    Missing,
    PluginError,
    Request,
    Series,
    Window,
)

if TYPE_CHECKING:
    import pyarrow as pa

SUFFIXES = (".so", ".dylib")
SECONDS = 60.0  # limit for one call
MEMORY = 4 * 2**30  # limit of the process's address space [B]

_PROCESS = Path(__file__).with_name("compiled_process.py")
_FIELD = re.compile(r"[A-Za-z]\w*(\.[A-Za-z]\w*)*")
_LARGEST = 1024 * 1024  # limit for an answer [B]


class PluginProcess:
    """The process of one compiled plugin for one recording.

    Parameters
    ----------
    library : Path
    seconds : float
        Limit for one call.
    """

    def __init__(self, library: Path, seconds: float = SECONDS) -> None:
        self._seconds = seconds
        self._dead = ""
        self._process = subprocess.Popen(
            [sys.executable, "-I", str(_PROCESS), str(library.resolve()), str(MEMORY)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, bufsize=0,
        )  # fmt: skip
        weakref.finalize(self, _end, self._process)

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a request.

        Raises
        ------
        PluginError
            The library is invalid, returned an error, took too long or crashed. After the last two,
            every further request raises the same error.
        """
        if self._dead:
            raise PluginError(self._dead)
        assert self._process.stdin is not None  # noqa: S101 -- it is a pipe
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            answer: dict[str, Any] = json.loads(self._line())
        except (BrokenPipeError, EOFError):
            self._dead = f"the process of the compiled plugin ended: {self._end()}"
            raise PluginError(self._dead) from None
        except (TimeoutError, ValueError) as error:
            self._process.kill()
            self._dead = f"the compiled plugin was ended: {error}"
            raise PluginError(self._dead) from None
        if "error" in answer:
            raise PluginError(str(answer["error"]))
        return answer

    def _line(self) -> bytes:
        assert self._process.stdout is not None  # noqa: S101 -- it is a pipe
        line, end_s = b"", time.monotonic() + self._seconds
        while not line.endswith(b"\n"):
            ready, _, _ = select.select(
                [self._process.stdout], [], [], max(0.0, end_s - time.monotonic())
            )
            if not ready:
                raise TimeoutError(f"it took longer than {self._seconds:g} s")
            part = self._process.stdout.read(65536)
            if not part:
                raise EOFError
            line += part
            if len(line) > _LARGEST:
                raise ValueError(f"it answered with more than {_LARGEST} bytes")
        return line

    def _end(self) -> str:
        code = self._process.wait()
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"


def load_compiled(library: Path) -> FeaturePlugin:
    """Return the feature plugin of a shared library.

    Raises
    ------
    PluginError
        The library is not a plugin, is for another version, or has an invalid description.
    """
    text = PluginProcess(library).ask({})["description"]
    try:
        given = json.loads(text)
        features = tuple(
            Feature(
                str(each["name"]), str(each["unit"]), float(each["floor"]),
                str(each["description"]), "domain",
            )
            for each in given["features"]
        )  # fmt: skip
        fields = {str(key): [*map(str, asked["fields"])] for key, asked in given["topics"].items()}
        requests = {key: _request(given["topics"][key], of) for key, of in fields.items()}
        name, family = str(given["name"]), str(given["family"])
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise PluginError(f"its description has a fault: {error!r}") from error
    return FeaturePlugin(
        name, family, features, partial(_compute, fields, tuple(each.name for each in features)),
        requests, prepare=lambda _: PluginProcess(library),
    )  # fmt: skip


def _request(asked: Mapping[str, Any], fields: list[str]) -> Request:
    for field in fields:
        if not _FIELD.fullmatch(field):
            raise ValueError(f"{field!r} is no field of a message")
    places: dict[str, Any] = {
        ours: str(asked[theirs])
        for ours, theirs in (("role", "role"), ("msgtype", "msgtype"), ("name", "topic"))
        if theirs in asked
    }
    if not fields or not places:
        raise ValueError("a request needs fields, and a role, msgtype or topic")
    return Request(_keeper(fields), dtype=object, **places)


def _keeper(fields: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    """Return a function that extracts fields of a message, each a number or an array of numbers."""
    getters = [attrgetter(field) for field in fields]
    return lambda message: tuple(np.asarray(get(message), dtype=np.float64) for get in getters)


def _compute(
    fields: Mapping[str, list[str]], names: tuple[str, ...], window: Window
) -> dict[str, float | Missing]:
    """Return the features that the process computes from the tables of a window."""
    import pyarrow as pa

    process: PluginProcess = window.prepared
    with tempfile.TemporaryDirectory(prefix="oracle-plugin-") as folder:
        for key, wanted in fields.items():
            batch = _batch(window.topics[key], wanted)
            with pa.ipc.new_file(str(Path(folder) / f"{key}.arrow"), batch.schema) as sink:
                sink.write_batch(batch)
        asked = {"folder": folder, "start_s": window.start_s, "end_s": window.end_s}
        found = process.ask({**asked, "tables": [*fields]})["features"]
    if list(found) != list(names):
        raise PluginError(f"it returned {', '.join(found)} instead of {', '.join(names)}")
    nothing = Missing("the plugin returned no number")
    return {n: nothing if v is None or math.isnan(v) else float(v) for n, v in found.items()}


def _batch(topics: Mapping[str, Series], fields: list[str]) -> "pa.RecordBatch":
    """Return the messages of some topics as one table."""
    import pyarrow as pa

    rows = [row for series in topics.values() for row in series.values]
    columns: dict[str, pa.Array] = {
        "topic": pa.array(
            [name for name, series in topics.items() for _ in series.times_s], pa.utf8()
        ),
        "time_s": pa.array(np.concatenate([series.times_s for series in topics.values()])),
    }
    for place, field in enumerate(fields):
        values = [row[place] for row in rows]
        if values[0].ndim == 0:
            columns[field] = pa.array([float(value) for value in values], pa.float64())
        else:
            ends = np.cumsum([0, *map(len, values)]).astype(np.int32)
            flat = pa.array(np.concatenate(values), pa.float64())
            columns[field] = pa.ListArray.from_arrays(pa.array(ends), flat)
    return pa.RecordBatch.from_pydict(columns)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process that is no longer needed."""
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
