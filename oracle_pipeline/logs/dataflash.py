"""ArduPilot DataFlash, by pymavlink: each type of message is a topic."""

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.DFReader import DFReader_binary

from oracle_pipeline.logs.log import LATEST_NS, Log, LogError, LogTopic, numeric, reading

_SKIPPED = {"FMT", "FMTU", "UNIT", "MULT", "PARM", "FILE", "MSG"}  # about the log; no signals
# Fields with the time, and its unit [ns]. In logs of old releases, GPS has it as T, and its TimeMS
# is that of the week.
TIME = "TimeUS"
_TIMES = {TIME: 1_000, "T": 1_000_000, "TimeMS": 1_000_000}
_INSTANCES = ("I", "Instance", "C", "Core")  # fields that number sensors and estimators


def read_dataflash(path: Path) -> Log:
    """Read a ``.bin`` file.

    Topics have the names of messages, ``/ATT``; those of several sensors are numbered, ``/IMU_0``.
    Times are since the start of the flight controller.

    Raises
    ------
    LogError
        If the file is damaged or holds no messages.
    """
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    with reading(path, "a DataFlash log"):
        for message in iter(DFReader_binary(str(path), zero_time_base=True).recv_msg, None):
            if message.get_type() not in _SKIPPED:
                fields = message.to_dict()
                suffix = next((f"_{fields.pop(key)}" for key in _INSTANCES if key in fields), "")
                rows[f"/{fields.pop('mavpackettype')}{suffix}"].append(fields)
    return log_of(path, rows)


def log_of(path: Path, rows: Mapping[str, list[dict[str, Any]]]) -> Log:
    """Return a log of the fields of messages, by the names of topics.

    Raises
    ------
    LogError
        If no topic has numbers and times.
    """
    found = Log([])
    for name, messages in sorted(rows.items()):
        columns = numeric((key, np.array([m.get(key) for m in messages])) for key in messages[0])
        time = next((field for field in _TIMES if field in columns), None)
        if time is None or len(columns) == 1:
            found.notes.append(f"{name} has no numbers or no time and is not used.")
            continue
        times = columns.pop(time)
        known = (times >= 0) & (times < LATEST_NS / _TIMES[time])
        if lost := int((~known).sum()):
            found.notes.append(f"{name}: {lost} messages with a damaged time are not used.")
        kept = {each: values[known] for each, values in columns.items()}
        found.topics.append(LogTopic(name, times[known].astype(np.int64) * _TIMES[time], kept))
    if not found.topics:
        raise LogError(f"{path} holds no messages.")
    return found
