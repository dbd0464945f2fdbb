"""LeRobot data sets of versions 2 and 3: each episode is a recording."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from oracle_pipeline.logs.files import EPISODE, information
from oracle_pipeline.logs.log import Log, LogError, LogTopic, reading


def read_episode(path: Path) -> Log:
    """Read one episode: a topic for each feature, such as ``/observation/state`` and ``/action``.

    Parameters
    ----------
    path : Path
        ``<data set>/episode_000003``. The data are in a file of their own (version 2), or in one
        with other episodes (version 3).

    Raises
    ------
    LogError
        If the data set is damaged, or has no such episode.
    """
    dataset = path.parent
    about = information(dataset)
    text = path.name.removeprefix(EPISODE)
    if not text.isdecimal():
        raise LogError(f"{path} is no episode; their names are like {EPISODE}000003.")
    table = _rows(dataset, int(text))
    if not len(table):
        raise LogError(f"{dataset} has no episode {int(text)}.")
    times_ns = _times_ns(table, about)
    log = Log([])
    for name, feature in about.get("features", {}).items():
        values = _values(table, name)
        if name in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
            continue
        if values is None:
            if name in table.column_names:
                log.notes.append(f"{name} holds no numbers and is not used.")
            continue
        columns = _named(values, feature.get("names"))
        log.topics.append(LogTopic("/" + name.replace(".", "/"), times_ns, columns))
    if not log.topics:
        raise LogError(f"{path} has no feature of numbers.")
    return log


def _rows(dataset: Path, episode: int) -> pa.Table:
    """Return the rows of an episode."""
    own = sorted(dataset.glob(f"data/chunk-*/{EPISODE}{episode:06d}.parquet"))
    files = own or sorted(dataset.glob("data/chunk-*/file-*.parquet"))
    if not files:
        raise LogError(f"{dataset} has no data of episode {episode}.")
    chosen = None if own else [("episode_index", "=", episode)]
    with reading(files[0], "Parquet"):
        return pa.concat_tables(
            [pq.read_table(file, filters=chosen, partitioning=None) for file in files]
        )


def _times_ns(table: pa.Table, about: dict[str, Any]) -> Any:
    if "timestamp" in table.column_names:
        seconds = table["timestamp"].to_numpy().astype(np.float64).ravel()
    else:
        seconds = np.arange(len(table)) / float(about.get("fps", 1.0))
    return np.round(seconds * 1e9).astype(np.int64)


def _values(table: pa.Table, name: str) -> Any:
    """Return a feature as shape (n, k); None if it holds no numbers."""
    if name not in table.column_names:
        return None
    try:
        rows = np.stack([np.ravel(row) for row in table[name].to_numpy()])
    except ValueError:
        return None
    return rows.astype(np.float64) if rows.dtype.kind in "biuf" else None


def _named(values: Any, names: Any) -> dict[str, Any]:
    """Return columns by the names that the data set states, also in a group, or as one array."""
    groups = names.values() if isinstance(names, dict) else names or ()
    names = next((each for each in groups if isinstance(each, list)), names)
    if isinstance(names, list) and len(names) == values.shape[1]:
        return {str(name): values[:, number] for number, name in enumerate(names)}
    return {"value": values if values.shape[1] > 1 else values[:, 0]}
