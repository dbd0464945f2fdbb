"""What every reader of logs returns: topics, each with times and columns of numbers."""

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import BagError, one_line, refuse_pointer

LATEST_NS = 2.0**62  # in 2116; a later time is damaged


class LogError(BagError):
    """A log cannot be read as it is, or as its layout says."""


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Turn any error of a parser into a `LogError` of one line; parsers of damaged files raise all.

    A package that is not installed stays a ``ModuleNotFoundError``. What a parser prints, such as a
    line for each damaged byte, is dropped.
    """
    try:
        refuse_pointer(path)
        with Path(os.devnull).open("w") as none, redirect_stdout(none), redirect_stderr(none):
            yield
    except (BagError, ModuleNotFoundError):
        raise
    except Exception as error:
        raise LogError(f"{path} cannot be read as {kind}: {one_line(error)}.") from error


class LogTopic(NamedTuple):
    """The messages of one topic, as columns.

    Attributes
    ----------
    name : str
        ``/imu``.
    times_ns : ndarray of int64, shape (n,)
        When each message was logged [ns], in the order of the file.
    columns : mapping of str to ndarray
        By field, such as ``orientation.x``: shape (n,), or (n, k) for an array of k numbers.
    msgtype : str
        A ROS type whose fields the columns are; empty: a type is made for the columns.
    texts : mapping of str to str
        Strings that all messages have, such as ``header.frame_id``.
    units : mapping of str to str
        Units of columns, where the log or its layout states them.
    """

    name: str
    times_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[Any]]
    msgtype: str = ""
    texts: Mapping[str, str] = {}
    units: Mapping[str, str] = {}


@dataclass(slots=True)
class Log:
    """The content of a log, and remarks on what was not used."""

    topics: list[LogTopic]
    notes: list[str] = field(default_factory=list)


def grouped(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Join the numbers of arrays: ``q[0]``, ``q[1]`` or ``q_0``, ``q_1`` become ``q``.

    Examples
    --------
    >>> grouped({"q[0]": np.zeros(2), "q[1]": np.ones(2), "t": np.zeros(2)})["q"].tolist()
    [[0.0, 1.0], [0.0, 1.0]]
    """
    joined: dict[str, NDArray[Any]] = {}
    for name, values in columns.items():
        base, index = _indexed(name)
        size = _size(base, name, columns) if index is not None else 0
        if size < 2:
            joined[name] = values
        elif index == 0:
            form = name.removeprefix(base).replace("0", "{}")
            parts = [columns[base + form.format(number)] for number in range(size)]
            joined[base] = np.stack(parts, axis=1)
    return joined


def _indexed(name: str) -> tuple[str, int | None]:
    """Return base and index of ``q[1]`` or ``q_1``; no index for other names."""
    plain = name.removesuffix("]")
    base, separator, number = plain.rpartition("[" if plain != name else "_")
    return (base, int(number)) if separator and number.isdecimal() else (name, None)


def _size(base: str, name: str, columns: Mapping[str, NDArray[Any]]) -> int:
    """Return how many elements an array has that begins at 0 and has no gap; else 0."""
    form = "{}[{}]" if name.endswith("]") else "{}_{}"
    size = 0
    while form.format(base, size) in columns:
        size += 1
    others = sum(_indexed(other)[0] == base for other in columns)
    return size if size == others or name.endswith("]") else 0


def numeric(columns: Iterable[tuple[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Return the columns that hold numbers or truth values."""
    return {name: values for name, values in columns if values.dtype.kind in "biuf"}
