"""Decides how much of each run is kept on disk: more of the first blocks, equal within a block.

A pure function of sizes, which ``resources.storage.stock`` measures. docs/how-to/storage.md gives
the reasons.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Kept


class StorageError(OracleError):
    """The requested runs do not fit, or a size is invalid."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Storage of one run with graphs and features, by how much of it is kept [B]."""

    full: int
    trimmed: int
    recipe: int

    def of(self, kept: Kept) -> int:
        """Return the size of a run if this much of it is kept."""
        size: int = getattr(self, kept)
        return size


def plan(blocks: Mapping[int, Sequence[Sizes]], available: int) -> dict[int, Kept]:
    """Return how much to keep of the runs of each block.

    All blocks keep the recipe. As many of the first blocks as fit keep a trimmed bag, and as many
    of these as fit the full bag. All runs of a block keep the same, so that storage never
    identifies a mode.

    Parameters
    ----------
    blocks
        The sizes of the runs of each block.
    available
        Storage for all of them together [B].

    Raises
    ------
    StorageError
        If graphs and features alone do not fit; it states the number of blocks that would.
    """
    kept: dict[int, Kept] = dict.fromkeys(sorted(blocks), "recipe")
    taken = sum(_size(blocks[block], "recipe") for block in kept)
    if taken > available:
        raise StorageError(_size_message(blocks, taken, available))
    for better in ("trimmed", "full"):
        for block in kept:
            more = _size(blocks[block], better) - _size(blocks[block], kept[block])
            if taken + more > available:
                break
            kept[block] = better
            taken += more
    return kept


def _size(runs: Sequence[Sizes], kept: Kept) -> int:
    return sum(run.of(kept) for run in runs)


def _size_message(blocks: Mapping[int, Sequence[Sizes]], taken: int, available: int) -> str:
    fitting, room = 0, available
    for block in sorted(blocks):
        room -= _size(blocks[block], "recipe")
        if room < 0:
            break
        fitting += 1
    return (
        f"{len(blocks)} blocks of runs do not fit: graphs and features alone take "
        f"{megabytes(taken)}, and {megabytes(max(available, 0))} are available. "
        f"The first {fitting} blocks would fit. Materialize fewer runs, raise "
        "ORACLE_STORAGE_BUDGET, free some space, or point ORACLE_HOME to another disk."
    )


def megabytes(size: int) -> str:
    """Return a size in megabytes, as text."""
    return f"{size / 1e6:.1f} MB"
