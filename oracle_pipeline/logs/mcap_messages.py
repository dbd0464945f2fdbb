"""MCAP with Protobuf or JSON messages, by the packages of MCAP: each channel is a topic."""

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from numpy.typing import NDArray

from oracle_pipeline.logs.log import Log, LogError, LogTopic, reading

_MOST_ELEMENTS = 64  # of an array whose elements are columns
_LARGEST = 4096  # numbers of an array; longer ones are images or clouds, and not used


def read_mcap(path: Path) -> Log:
    """Read the messages of all channels; nested fields have names such as ``pose.position.x``.

    Raises
    ------
    LogError
        If the file is damaged or holds no numbers.
    """
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    stamps: dict[str, list[int]] = defaultdict(list)
    decoders: dict[int, Any] = {}
    with reading(path, "MCAP"), path.open("rb") as source:
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.message_encoding == "json":
                content = json.loads(message.data)
            else:
                if channel.id not in decoders:
                    decoders[channel.id] = DecoderFactory().decoder_for("protobuf", schema)
                content = decoders[channel.id](message.data)
            topic = channel.topic if channel.topic.startswith("/") else f"/{channel.topic}"
            rows[topic].append(dict(_numbers(content)))
            stamps[topic].append(message.log_time)
    log = Log([])
    for topic, messages in rows.items():
        names = dict.fromkeys(name for message in messages for name in message)
        columns = {name: _column([each.get(name, np.nan) for each in messages]) for name in names}
        if columns:
            log.topics.append(LogTopic(topic, np.array(stamps[topic], dtype=np.int64), columns))
        else:
            log.notes.append(f"{topic} holds no numbers and is not used.")
    if not log.topics:
        raise LogError(f"{path} holds no numbers.")
    return log


def _column(values: Sequence[Any]) -> NDArray[np.float64]:
    """Return numbers, or arrays of numbers that may differ in length, as rows."""
    rows = np.full((len(values), max(map(np.size, values))), np.nan)
    for row, value in zip(rows, values, strict=True):
        row[: np.size(value)] = value
    return rows if rows.shape[1] > 1 else rows[:, 0]


def _numbers(content: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers in nested messages and lists, and long lists of numbers, with paths."""
    if hasattr(content, "DESCRIPTOR"):  # of Protobuf, with the fields that have default values
        content = {field.name: getattr(content, field.name) for field in content.DESCRIPTOR.fields}
    if isinstance(content, bool | int | float):
        yield path, float(content)
    elif isinstance(content, Mapping):
        for name, value in content.items():
            yield from _numbers(value, f"{path}.{name}" if path else str(name))
    elif isinstance(content, str | bytes) or not isinstance(content, Sequence):
        return
    elif len(content) <= _MOST_ELEMENTS:
        for index, value in enumerate(content):
            yield from _numbers(value, f"{path}[{index}]")
    elif len(content) <= _LARGEST:
        with suppress(TypeError, ValueError):
            yield path, np.array(content, np.float64)
