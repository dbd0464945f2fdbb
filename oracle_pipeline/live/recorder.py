"""A recording of a watch: a bag, the graph of each interval, and a summary.

``<folder>/<name>`` holds ``bag/``, ``graphs/`` and ``recording.json`` from its first second on, and
is readable up to the last flush. The summary says whether it is complete; while it is written, the
folder is locked. `recover` finishes one whose watch was killed.
"""

import contextlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rosbags.interfaces import Qos

from oracle_pipeline.bags.graph_files import RosGraph, write_gexf, write_graphml
from oracle_pipeline.bags.run_directory import BAG_FOLDER, GRAPHS_FOLDER, RECORDING_FILE
from oracle_pipeline.bags.scratch import lock
from oracle_pipeline.graphs.intervals import compose, read_intervals
from oracle_pipeline.live.split_bag import Message, Split, SplitBag

_SHARE, _LEAST, _MOST = 0.02, 2 * 2**20, 2**30  # of the disk that stays free [B]


class Recorder:
    """Writes one recording.

    Parameters
    ----------
    path : Path
        Folder of the recording; it must not exist.
    facts : dict
        As for the attribute.
    split : Split
        When a file of the bag ends.
    keep_free_bytes : int, optional
        Free space at which the recording ends; by default 2 % of the disk, at most 1 GiB.

    Attributes
    ----------
    facts : dict
        Content of ``recording.json``, beside the counts of messages.
    ended : str
        Why nothing is recorded any more; empty while it goes on.
    start_s : float
        When it begins [s of the segment].
    """

    def __init__(
        self,
        path: Path,
        facts: dict[str, Any],
        split: Split,
        keep_free_bytes: int | None = None,
        start_s: float = 0.0,
    ) -> None:
        (path / GRAPHS_FOLDER).mkdir(parents=True)
        self.path = path
        self.facts = facts
        self.ended = ""
        self.start_s = start_s
        self._files = [start_s]  # when each file begins
        self._leads = False  # whether a file of latched messages is the first
        self._lock = contextlib.ExitStack()
        self._lock.enter_context(lock(path, wait=False))
        self._floor = _floor(path) if keep_free_bytes is None else keep_free_bytes
        self._run: RosGraph = compose(())
        self._bag = SplitBag(path / BAG_FOLDER, split)
        self._describe(complete=False)

    def add_topic(self, name: str, msgtype: str, qos: Sequence[Qos]) -> None:
        """Announce a topic, or more publishers of it."""
        self._bag.add_topic(name, msgtype, qos)

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a message."""
        if not self.ended:
            with self._while_possible():
                self._bag.write(topic, stamp_ns, data)

    def flush(self) -> None:
        """Write everything to the disk, if there is enough space; call it once a second."""
        if self.ended:
            return
        if (free := _free_bytes(self.path)) < self._floor:
            self._end(f"only {free / 2**20:.0f} MiB are free where it is written")
            return
        with self._while_possible():
            self._bag.flush()

    def write_graph(self, start_s: int, graph: RosGraph) -> None:
        """Write the graph of the interval that began at a second, and the facts so far."""
        self._run = compose((self._run, graph))
        if self.ended:
            return
        with self._while_possible():
            name = _graph_name(start_s - self.start_s)
            write_whole(self.path / GRAPHS_FOLDER / name, lambda path: write_gexf(graph, path))
            self._describe(complete=False)

    def forget(self, now_s: float, before_s: float, latched: Sequence[Message]) -> None:
        """End a file, and delete those that are over before a time [s of the segment].

        Of the latched messages, those that were sent before what is left begin the recording.
        """
        if self.ended:
            return
        with self._while_possible():
            self._bag.cut()
            self._files.append(now_s)
            over = sum(begin_s <= before_s for begin_s in self._files[1:])
            if not over:
                return
            passed_s = self._files[over] - self.start_s
            start_ns = self.facts["start_ns"] + round(passed_s * 1e9)
            lead = [
                each._replace(stamp_ns=start_ns) for each in latched if each.stamp_ns < start_ns
            ]
            self._bag.forget(over + self._leads, lead)
            self._leads = bool(lead)
            self._shift_graphs(passed_s)
            self.facts["start_ns"], self.start_s = start_ns, self._files[over]
            del self._files[:over]

    def _shift_graphs(self, passed_s: float) -> None:
        graphs = self.path / GRAPHS_FOLDER
        for path in sorted(graphs.glob("*.gexf")):
            start_s = int(path.stem) - passed_s
            path.unlink() if start_s < 0 else path.rename(graphs / _graph_name(start_s))

    def close(self) -> None:
        """End the recording, whatever has happened before."""
        if not self.ended:
            self._bag.close()
        graphs = self.path / GRAPHS_FOLDER
        with contextlib.suppress(OSError):
            if self._leads or len(self._files) > 1:  # some intervals were deleted
                self._run = compose(each.graph for each in read_intervals(graphs, gaps=True))
            write_gexf(self._run, graphs / "run.gexf")
            write_graphml(self._run, graphs / "run.graphml")
        with contextlib.suppress(OSError):
            self._describe(complete=True)
        self._lock.close()

    def _describe(self, *, complete: bool) -> None:
        document = {**self.facts, "messages": dict(self._bag.counts), "ended": self.ended}
        write_summary(self.path, {"complete": complete, **document})

    @contextlib.contextmanager
    def _while_possible(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._end(error.strerror or str(error))

    def _end(self, reason: str) -> None:
        self.ended = reason
        self._bag.close()


def _graph_name(start_s: float) -> str:
    return f"{round(start_s):06d}.gexf"


def write_summary(folder: Path, document: dict[str, Any]) -> None:
    """Write ``recording.json``."""
    text = json.dumps(document, indent=1, allow_nan=False) + "\n"
    write_whole(folder / RECORDING_FILE, lambda path: path.write_text(text, encoding="utf-8"))


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file that is never seen in part."""
    unfinished = path.with_name(f"{path.name}.tmp")
    write(unfinished)
    unfinished.replace(path)


def _free_bytes(path: Path) -> int:
    disk = os.statvfs(path)
    return disk.f_bavail * disk.f_frsize


def _floor(path: Path) -> int:
    disk = os.statvfs(path)
    return round(min(_MOST, max(_LEAST, _SHARE * disk.f_blocks * disk.f_frsize)))
