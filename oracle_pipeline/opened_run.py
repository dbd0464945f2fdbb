"""A run directory, a live recording or a foreign bag, opened and checked.

A run directory has a manifest, a bag and graphs. A live recording of ``oracle watch`` has a bag and
graphs. A foreign bag has neither manifest nor graphs. Any other log is written as a bag first.
"""

import logging
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from oracle_pipeline.bags.disturbances import Disturbances
from oracle_pipeline.bags.errors import BagError, RunDirectoryError
from oracle_pipeline.bags.integrity import require_undamaged
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.reader import BagReader
from oracle_pipeline.bags.run_directory import (
    BAG_FOLDER,
    GRAPHS_FOLDER,
    MANIFEST_FILE,
    RECORDING_FILE,
    recording_summary,
)
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from oracle_pipeline.graphs.intervals import Interval, read_intervals
from oracle_pipeline.logs.files import kind_of
from oracle_pipeline.logs.formats import open_as_bag

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class OpenedRun:
    """One recording; a context manager that closes its bag."""

    path: Path
    bag: BagReader
    manifest: Manifest | None  # None for a live recording or a foreign bag
    intervals: tuple[Interval, ...]  # empty for a foreign bag
    scratch: "tempfile.TemporaryDirectory[str] | None" = None  # of the bag of another log
    disturbances: Disturbances = field(default_factory=Disturbances)  # of its recorder

    @property
    def duration_s(self) -> float:
        """Time from the first message to the last [s]."""
        return (self.bag.end_ns - self.bag.start_ns) * 1e-9

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: object) -> None:
        self.bag.close()
        if self.scratch is not None:
            self.scratch.cleanup()


def open_run(path: Path, *, strict: bool = False) -> OpenedRun:
    """Open a run directory, a live recording or a foreign bag.

    Parameters
    ----------
    path : Path
        ``<root>/runs/<mode>/run003``, a recording of ``oracle watch``, the folder of a rosbag2, a
        single ``.mcap`` or ``.db3`` file, a ROS 1 ``.bag``, or a log that ``oracle_pipeline.logs``
        reads.

    The files of a run directory are first compared with the hashes in its manifest. Runs of older
    releases have no hashes; they are opened with a warning.

    Raises
    ------
    OracleError
        If it is none of these, incomplete or damaged, or if its bag does not match its manifest.
    """
    if (path / MANIFEST_FILE).is_file():
        return _open_run_directory(path)
    if (path / RECORDING_FILE).is_file():
        return _open_watched(path, strict=strict)
    if any((path / part).exists() for part in (BAG_FOLDER, GRAPHS_FOLDER)):
        raise RunDirectoryError(
            f"{path} looks like a run directory but has no {MANIFEST_FILE}, so the run is "
            f"incomplete; record it again, or use {path / BAG_FOLDER} to read only its bag."
        )
    if kind_of(path) is not None:
        return _open_log(path)
    bag = BagReader(path, strict=strict)
    encodings = {topic.encoding for topic in bag.topics.values()}
    if encodings and encodings <= {"json", "protobuf"} and path.is_file():
        bag.close()
        return _open_log(path)
    return OpenedRun(path, bag, None, ())


def _open_watched(path: Path, *, strict: bool) -> OpenedRun:
    disturbances = Disturbances.from_dict(recording_summary(path) or {})
    loss = disturbances.loss()
    if loss and strict:
        raise BagError(f"{path} is incomplete. {loss} Without --strict, it is used.")
    bag = BagReader(path / BAG_FOLDER, strict=strict)
    bag.losses += [loss] if loss else []
    if disturbances.spans:
        seconds = sum(end_s - begin_s for begin_s, end_s in disturbances.spans)
        bag.notes.append(
            f"In {seconds:g} s of it, messages were lost or the machine that recorded them was "
            "late, so features of rate and timing are missing there and for the whole recording."
        )
    intervals = read_intervals(path / GRAPHS_FOLDER, gaps=True)
    return OpenedRun(path, bag, None, intervals, disturbances=disturbances)


def _open_log(path: Path) -> OpenedRun:
    bag, notes, scratch = open_as_bag(path)
    reader = BagReader(bag)
    reader.notes += notes
    return OpenedRun(path, reader, None, (), scratch)


def _open_run_directory(path: Path) -> OpenedRun:
    manifest = Manifest.load(path / MANIFEST_FILE)
    if not (path / BAG_FOLDER).exists():
        raise BagError(
            f"{path} has no bag, perhaps to save space; `oracle-sim remake {path}` re-simulates it."
        )
    if manifest.measured.files:
        require_undamaged(path, manifest)
    else:
        _log.warning(
            "%s was recorded by an older release and has no hashes: damage to its files may go "
            "unnoticed. `oracle-sim remake %s` rebuilds it, with hashes.",
            path,
            path,
        )
    watched = recording_summary(path)  # a live system may be silent, or disturbed
    intervals = read_intervals(path / GRAPHS_FOLDER, gaps=watched is not None)
    bag = BagReader(path / BAG_FOLDER, strict=True)
    claimed = {name: topic.messages for name, topic in manifest.topics.items()}
    claimed.pop(GROUND_TRUTH_TOPIC, None)
    held = {name: topic.count for name, topic in bag.topics.items()}
    if held != claimed:
        bag.close()
        differing = sorted(n for n in held | claimed if held.get(n) != claimed.get(n))
        raise BagError(
            f"{bag.path} is not the complete bag of {path / MANIFEST_FILE}: the numbers of "
            f"messages on {', '.join(differing)} differ. If it was trimmed to save space, "
            f"`oracle-sim remake {path}` restores it."
        )
    disturbances = Disturbances.from_dict(watched or {})
    return OpenedRun(path, bag, manifest, intervals, disturbances=disturbances)
