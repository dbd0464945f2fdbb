"""What kind of log a path is, by its name, its first bytes and the columns of Parquet."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, TypeAlias

from oracle_pipeline.bags.parts import is_recording
from oracle_pipeline.logs.log import reading

LogFormat: TypeAlias = Literal["tables", "lerobot", "ulog", "dataflash", "telemetry"]

EPISODE = "episode_"
_INFORMATION = Path("meta", "info.json")  # of a LeRobot data set
_LARGEST = 16 * 2**20  # bytes of it

_KEYS = {"run_id", "mode", "label", "block"}  # of a table of features
_SUFFIXES = (".csv", ".tsv", ".parquet")
_MAGIC: dict[bytes, LogFormat] = {b"ULog\x01\x12\x35": "ulog", b"\xa3\x95\x80": "dataflash"}


def kind_of(path: Path) -> LogFormat | None:
    """Return what kind of log a path is; None for bags, MCAP included, and everything else."""
    if path.is_dir():
        return "tables" if not is_recording(path) and tables_in(path) else None
    if is_episode(path):
        return "lerobot"
    if not path.is_file():
        return None
    if _is_table(path):
        return "tables"
    if path.suffix.lower() == ".tlog":  # it begins with a time
        return "telemetry"
    with path.open("rb") as source:
        begin = source.read(8)
    return next((kind for magic, kind in _MAGIC.items() if begin.startswith(magic)), None)


def tables_in(folder: Path) -> list[Path]:
    """Return the CSV and Parquet files in a folder, in order."""
    return sorted(entry for entry in folder.iterdir() if _is_table(entry))


def is_dataset(path: Path) -> bool:
    """Return whether a folder is a LeRobot data set."""
    return (path / _INFORMATION).is_file() and (path / "data").is_dir()


def is_episode(path: Path) -> bool:
    """Return whether a path names an episode, ``<data set>/episode_000003``."""
    return path.name.startswith(EPISODE) and not path.suffix and is_dataset(path.parent)


def episodes(dataset: Path) -> Iterator[Path]:
    """Yield the paths that name the episodes of a LeRobot data set."""
    for number in range(int(information(dataset).get("total_episodes", 0))):
        yield dataset / f"{EPISODE}{number:06d}"


def information(dataset: Path) -> dict[str, Any]:
    """Return what a LeRobot data set says of itself: its features, among others.

    Raises
    ------
    LogError
        If it says nothing that can be read.
    """
    file = dataset / _INFORMATION
    with reading(file, "the information of a LeRobot data set"):
        with file.open("rb") as source:
            about = json.loads(source.read(_LARGEST))
        if not isinstance(about, dict) or not isinstance(about.get("features"), dict):
            raise ValueError("it has no features")
        return about


def _is_table(path: Path) -> bool:
    """Return whether a path is a CSV or Parquet file, but none of our tables of features."""
    return path.suffix.lower() in _SUFFIXES and path.is_file() and not _has_features(path)


def _has_features(path: Path) -> bool:
    if path.suffix.lower() != ".parquet":
        return False
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return set(pq.read_schema(path).names) >= _KEYS
    except (pa.ArrowException, OSError, ValueError):
        return False  # a damaged one is for the reader, which says so
