"""Logs of all kinds: which recordings a path holds, their content, and that as a bag."""

import importlib
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal, NamedTuple

from oracle_pipeline.bags.layout import DATASETS, FEATURES, FOREIGN, REPORT, RUNS
from oracle_pipeline.bags.parts import is_recording
from oracle_pipeline.bags.run_directory import MANIFEST_FILE, RECORDING_FILE
from oracle_pipeline.logs.files import LogFormat, episodes, is_dataset, kind_of, tables_in
from oracle_pipeline.logs.log import Log, LogError
from oracle_pipeline.logs.recording import write_bag

# Modules and functions by kind; imported when needed, as each has a heavy library.
_READERS: dict[LogFormat | Literal["mcap"], tuple[str, str]] = {
    "tables": ("tables", "read_tables"),
    "lerobot": ("lerobot", "read_episode"),
    "ulog": ("ulog", "read_ulog"),
    "dataflash": ("dataflash", "read_dataflash"),
    "telemetry": ("mavlink", "read_telemetry"),
    "mcap": ("mcap_messages", "read_mcap"),
}


class OpenedLog(NamedTuple):
    """A log, written as a bag into a temporary folder, which the caller removes."""

    bag: Path
    notes: list[str]
    folder: "tempfile.TemporaryDirectory[str]"


def logs_at(path: Path) -> Iterator[Path] | None:
    """Return the recordings that a path is or directly holds as logs; None if there is none."""
    if path.is_dir() and is_dataset(path):
        return episodes(path)
    if path.is_dir() and tables_in(path):
        from oracle_pipeline.logs.tables import is_folder_of_topics

        return iter([path] if is_folder_of_topics(path) else tables_in(path))
    return iter([path]) if kind_of(path) else None


def recordings_below(folder: Path) -> Iterator[Path]:
    """Find the run directories, bags and other logs below a folder, in order.

    Tables that the pipeline writes into a root are no logs.
    """
    is_run = any((folder / name).is_file() for name in (MANIFEST_FILE, RECORDING_FILE))
    if is_run or is_recording(folder):
        yield folder
    elif (logs := logs_at(folder)) is not None:
        yield from logs
    elif folder.is_dir():
        ours = {FEATURES, DATASETS, REPORT, FOREIGN} if (folder / RUNS).is_dir() else set()
        for entry in sorted(folder.iterdir()):
            if not entry.name.startswith(".") and entry.name not in ours:
                yield from recordings_below(entry)


def recordings_at(paths: Iterable[Path]) -> list[Path]:
    """Return the recordings that paths are or hold; what holds none stays, to be refused."""
    return [each for path in paths for each in list(recordings_below(path)) or [path]]


def read_log(path: Path) -> Log:
    """Read a log of any known kind.

    Raises
    ------
    LogError
        If it is none, damaged, or its reader is not installed.
    """
    kind = "mcap" if path.suffix == ".mcap" else kind_of(path)
    if kind is None:
        raise LogError(
            f"{path} is no log that can be read: CSV, Parquet, PX4 ULog, ArduPilot DataFlash, "
            "MAVLink telemetry, an episode of a LeRobot data set, or MCAP with Protobuf or JSON."
        )
    module, function = _READERS[kind]
    try:
        log: Log = getattr(importlib.import_module(f"{__package__}.{module}"), function)(path)
    except ModuleNotFoundError as error:
        raise LogError(
            f"{path} needs the package {error.name}: pip install 'ros2-behaviour-oracle[logs]'."
        ) from error
    return log


def open_as_bag(path: Path) -> OpenedLog:
    """Write a log as a bag into a temporary folder."""
    log = read_log(path)
    folder = tempfile.TemporaryDirectory(prefix="oracle-log-")
    try:
        bag = Path(folder.name) / "bag"
        write_bag(log, bag)
    except BaseException:
        folder.cleanup()
        raise
    return OpenedLog(bag, log.notes, folder)
