"""The recording of a watch: a bag, the graph of each interval, and a summary.

``<folder>/<name>`` holds ``bag/``, ``graphs/`` and, written last, ``recording.json``. Until it is
complete, it has a hidden name, so no program that reads the folder sees a part of it.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rosbags.interfaces import Qos

from oracle_pipeline.bags.graph_files import RosGraph, write_gexf, write_graphml
from oracle_pipeline.bags.run_directory import BAG_FOLDER, GRAPHS_FOLDER, RECORDING_FILE
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.graphs.intervals import compose


class Recorder:
    """Writes one recording; a context manager.

    Parameters
    ----------
    folder : Path
        Folder of recordings; it is created if it does not exist.
    name : str
        Name of this recording.

    Attributes
    ----------
    path : Path
        Folder of the complete recording.
    facts : dict
        Content of ``recording.json``, beside the counts of messages.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.path = folder / name
        self.facts: dict[str, Any] = {}
        self._unfinished = folder / f".{name}.unfinished"
        self._run: RosGraph = compose(())
        (self._unfinished / GRAPHS_FOLDER).mkdir(parents=True)
        self._bag = BagWriter(self._unfinished / BAG_FOLDER)

    def add_topic(self, name: str, msgtype: str, qos: Sequence[Qos]) -> None:
        """Announce a topic, or more publishers of it."""
        self._bag.add_topic(name, msgtype, qos)

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a message."""
        self._bag.write(topic, stamp_ns, data)

    def write_graph(self, start_s: int, graph: RosGraph) -> None:
        """Write the graph of the interval that began at a second of the recording."""
        write_gexf(graph, self._unfinished / GRAPHS_FOLDER / f"{start_s:06d}.gexf")
        self._run = compose((self._run, graph))

    def __enter__(self) -> Self:
        self._bag.__enter__()
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        messages = {} if exc_type else self._bag.counts
        self._bag.__exit__(exc_type, exc_value, traceback)
        if exc_type is not None:
            return
        write_gexf(self._run, self._unfinished / GRAPHS_FOLDER / "run.gexf")
        write_graphml(self._run, self._unfinished / GRAPHS_FOLDER / "run.graphml")
        _write_json(self._unfinished / RECORDING_FILE, {**self.facts, "messages": messages})
        self._unfinished.rename(self.path)


def _write_json(path: Path, document: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
