"""How much of a finished run is kept: its whole bag, a trimmed one, or the recipe only.

A trimmed bag lacks large topics that no feature needs. Graphs, picture and manifest stay, and so
does the content hash of the whole bag, which the recipe can re-simulate. ``resources.storage``
decides what is dropped, and when.
"""

import dataclasses
import heapq
import os
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Literal

from oracle_pipeline.bags import types
from oracle_pipeline.bags.errors import RunDirectoryError
from oracle_pipeline.bags.integrity import hashes_of_files, require_undamaged
from oracle_pipeline.bags.manifest import KEPT, Kept, Manifest
from oracle_pipeline.bags.reader import BagReader, RawMessage, read_ground_truth
from oracle_pipeline.bags.run_directory import (
    BAG_FOLDER,
    MANIFEST_FILE,
    RunDirectory,
    bytes_on_disk,
)
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE
from oracle_pipeline.bags.writer import BagWriter

HEAVY = 0.02  # of the bag's payload: lighter topics stay in a trimmed bag

Wanted = Callable[[BagReader], Collection[str]]  # returns the topics of a bag that stay


def retain(run: RunDirectory, kept: Kept, wanted: Wanted) -> Manifest:
    """Reduce the bag of a complete run to ``kept``, atomically.

    Parameters
    ----------
    run
        On this machine. A run that keeps no more than ``kept`` is left as it is.
    kept
        How much of the bag stays.
    wanted
        Returns the topics that stay in a trimmed bag, whatever their size.

    Returns
    -------
    Manifest
        Of the run as it is now, with the freed bytes in ``measured``.

    Raises
    ------
    OracleError
        If the bag cannot be read, or the disk is full; the run is unchanged then.
    """
    former = run.manifest()
    measured = former.measured
    if KEPT.index(kept) <= KEPT.index(measured.kept):
        return former
    if kept == "trimmed":
        require_undamaged(run.path, former, BAG_FOLDER)
    with run.staged() as scratch:
        try:
            _link_all_but_the_bag(run.path, scratch)
        except OSError as error:
            raise RunDirectoryError(
                f"Could not link the remaining files of {run.path}: {error}. Choose a root "
                "on a disk that has free space and supports hard links."
            ) from error
        if kept == "trimmed":
            with BagReader(run.bag) as bag:
                _trim(bag, scratch / BAG_FOLDER, wanted(bag))
        now = bytes_on_disk(scratch)
        freed = measured.bytes[BAG_FOLDER] - now[BAG_FOLDER]
        measured = dataclasses.replace(
            measured,
            kept=kept,
            bytes=now,
            freed_bytes=measured.freed_bytes + freed,
            files=_hashes(scratch, measured.files),
        )
        manifest = dataclasses.replace(former, measured=measured)
        manifest.save(scratch / MANIFEST_FILE)
    return manifest


def _hashes(scratch: Path, former: Mapping[str, str]) -> Mapping[str, str]:
    """Return the hashes of the new bag, and the known hashes of the other files."""
    if not former:
        return former  # recorded by an older release: the other files may be damaged
    stays = {file: digest for file, digest in former.items() if file.split("/")[0] != BAG_FOLDER}
    return {**hashes_of_files(scratch, BAG_FOLDER), **stays}


def _link_all_but_the_bag(run: Path, scratch: Path) -> None:
    for file in sorted(run.rglob("*")):
        part = file.relative_to(run)
        aside = part.parts[0] in (BAG_FOLDER, MANIFEST_FILE) or part.parts[0].startswith(".")
        if file.is_file() and not aside:
            (scratch / part).parent.mkdir(parents=True, exist_ok=True)
            os.link(file, scratch / part)


def _trim(bag: BagReader, path: Path, wanted: Collection[str]) -> None:
    """Write a bag again without large topics; the ground truth of the mode's node stays."""
    payload = Counter[str]()
    for message in bag.messages():
        payload[message.topic] += len(message.data)
    heavy = HEAVY * payload.total()
    topics = [t for t in bag.topics.values() if t.name in wanted or payload[t.name] < heavy]
    truth = [
        RawMessage(GROUND_TRUTH_TOPIC, stamp_ns, types.serialize(truth_message, GROUND_TRUTH_TYPE))
        for stamp_ns, truth_message in read_ground_truth(bag.path)
    ]
    storage: Literal["mcap", "sqlite3"] = "sqlite3" if any(bag.path.glob("*.db3")) else "mcap"
    with BagWriter(path, storage) as trimmed:
        for topic in topics:
            trimmed.add_topic(topic.name, topic.msgtype, topic.qos, bag.definition(topic.msgtype))
        if truth:
            trimmed.add_topic(GROUND_TRUTH_TOPIC, GROUND_TRUTH_TYPE, [])
        kept = bag.messages([topic.name for topic in topics])
        for topic_name, stamp_ns, data in heapq.merge(kept, truth, key=lambda m: m.stamp_ns):
            trimmed.write(topic_name, stamp_ns, data)
