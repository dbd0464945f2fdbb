"""Compares a complete run with its re-simulation and finds the first message that differs.

``assets.worker.run`` decides which of the two stays in use.
"""

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.layout import REFRESHED
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.reader import BagReader, RawMessage, content_hash
from oracle_pipeline.bags.remote import fetched, is_local
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.types import GROUND_TRUTH_TOPIC
from sim.experiments import RebuildResult, compared


@dataclass(frozen=True, slots=True)
class Reproduction:
    """The result of re-simulating a complete run."""

    comparison: RebuildResult
    former_hash: str  # of the messages
    new_hash: str
    first_difference: str = ""  # where it is unexplained


def refreshed_directory(run: RunDirectory) -> RunDirectory:
    """Return the directory of a re-simulated run that must not replace the previous one."""
    return replace(run, root=run.root / REFRESHED)


@contextlib.contextmanager
def separate_directory(run: RunDirectory) -> Iterator[RunDirectory]:
    """Yield a local directory for a re-simulated run, separate from the previous one."""
    if is_local(run.root):
        yield refreshed_directory(run)
        return
    with tempfile.TemporaryDirectory(prefix="oracle-") as root:
        yield replace(run, root=Path(root))


def judge(run: RunDirectory, former: Manifest, again: RunDirectory) -> Reproduction:
    """Compare a run with its re-simulation."""
    new = again.manifest()
    comparison = compared(former, new)
    where = _first_difference(run, former, again) if comparison == "unexplained" else ""
    return Reproduction(comparison, former.content_hash, new.content_hash, where)


def _first_difference(run: RunDirectory, former: Manifest, again: RunDirectory) -> str:
    """Return the first message that differs, or why it is unknown."""
    if former.measured.kept != "full":
        return "unknown: the previous bag is no longer complete"
    try:
        with fetched(run.bag) as bag, BagReader(bag) as one, BagReader(again.bag) as other:
            for pair in zip_longest(one.messages(), other.messages()):
                if pair[0] != pair[1]:
                    return _place_of(
                        min(filter(None, pair), key=lambda m: m.stamp_ns), one.start_ns
                    )
            if content_hash(bag) == content_hash(again.bag):
                return "none: the bags are equal, but the previous manifest belongs to another bag"
    except BagError as error:
        return f"unknown: {error}"
    return GROUND_TRUTH_TOPIC


def _place_of(message: RawMessage, start_ns: int) -> str:
    return f"{message.topic}, {(message.stamp_ns - start_ns) / 1e9:.3f} s after the first message"
