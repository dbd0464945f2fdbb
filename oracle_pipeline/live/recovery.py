"""Finishes recordings whose watch was killed.

What it flushed is there already; recovery cuts the rest of the last file, and writes what comes at
the end of a recording: summaries of files, ``metadata.yaml``, the graph of the whole recording.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.graph_files import write_gexf, write_graphml
from oracle_pipeline.bags.run_directory import (
    BAG_FOLDER,
    GRAPHS_FOLDER,
    RECORDING_FILE,
    is_complete_recording,
    recording_summary,
)
from oracle_pipeline.bags.scratch import lock
from oracle_pipeline.bags.storage import Information, write_metadata
from oracle_pipeline.bags.unfinished import NoMessageError, finish_mcap
from oracle_pipeline.graphs.intervals import compose, read_intervals
from oracle_pipeline.live.recorder import write_summary

KILLED = "the watch was killed"


class Recovered(NamedTuple):
    """What became of a recording."""

    path: Path
    messages: int
    fault: str  # why it could not be finished; empty if it was


def recover(folder: Path) -> Iterator[Recovered]:
    """Finish the recordings in a folder, or the folder itself, that no watch writes any more."""
    for path in [folder, *sorted(entry for entry in folder.iterdir() if entry.is_dir())]:
        if not (path / RECORDING_FILE).is_file() or is_complete_recording(path):
            continue
        try:
            with lock(path, wait=False):
                yield Recovered(path, _finish(path), "")
        except BlockingIOError:
            continue  # it is being written
        except (OSError, OracleError) as error:
            yield Recovered(path, 0, str(error))


def _finish(path: Path) -> int:
    """Finish a recording, and return its number of messages."""
    bag = path / BAG_FOLDER
    files = sorted(bag.glob(f"{BAG_FOLDER}_*.mcap"), key=lambda file: int(file.stem.split("_")[1]))
    told: list[Information] = []
    for file in files:
        try:
            told.append(finish_mcap(file))
        except NoMessageError:
            file.unlink()  # it had just begun
    if told:
        write_metadata(bag, told)
    graphs = path / GRAPHS_FOLDER
    whole = compose(interval.graph for interval in read_intervals(graphs, gaps=True))
    write_gexf(whole, graphs / "run.gexf")
    write_graphml(whole, graphs / "run.graphml")
    counts: dict[str, int] = {}
    for topic in (topic for file in told for topic in file["topics_with_message_count"]):
        name = topic["topic_metadata"]["name"]
        counts[name] = counts.get(name, 0) + topic["message_count"]
    facts = recording_summary(path) or {}
    write_summary(path, facts | {"complete": True, "messages": counts, "ended": KILLED})
    return sum(counts.values())
