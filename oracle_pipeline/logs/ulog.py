"""PX4 ULog, by pyulog: each logged uORB topic is a topic."""

import io
from pathlib import Path

import numpy as np
from pyulog import ULog

from oracle_pipeline.logs.log import Log, LogError, LogTopic, grouped, numeric, reading


class _File(io.BufferedReader):
    """A file that stops a parser which reads it without end, as pyulog does some damaged ones."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._calls = 1_000 + 3 * path.stat().st_size

    def read(self, size: int | None = -1) -> bytes:
        """Read, if there are fewer calls so far than three for each byte."""
        self._calls -= 1
        if self._calls < 0:
            raise RuntimeError("its parser comes to no end")
        return super().read(size)


def read_ulog(path: Path) -> Log:
    """Read a ``.ulg`` file.

    Topics have the names of uORB, ``/vehicle_attitude``; further instances are numbered from 1,
    ``/sensor_accel_1``. Times are since the start of the flight controller.

    Raises
    ------
    LogError
        If the file is damaged or holds no messages.
    """
    with reading(path, "ULog"), _File(path) as file:
        log = ULog(file)
        found = Log([])
        for data in log.data_list:
            columns = numeric((name, np.asarray(values)) for name, values in data.data.items())
            if (stamps := columns.pop("timestamp", None)) is None or not columns:
                found.notes.append(f"{data.name} has no numbers or no time and is not used.")
                continue
            name = f"/{data.name}" + (f"_{data.multi_id}" if data.multi_id else "")
            # What was published before the log began is logged as it was at its beginning.
            times_ns = np.maximum(stamps.astype(np.int64), log.start_timestamp) * 1000
            found.topics.append(LogTopic(name, times_ns, grouped(columns)))
    if log.file_corruption:
        found.notes.append("The file is damaged; parts of it could not be read.")
    if lost := sum(drop.duration for drop in log.dropouts):
        found.notes.append(f"Dropouts of the logger: {len(log.dropouts)}, {lost} ms in all.")
    if not found.topics:
        raise LogError(f"{path} holds no messages.")
    return found
