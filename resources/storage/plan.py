"""How much of each run is kept on disk: all blocks from the first on alike, as long as room lasts.

No Dagster and no files here: a pure function of sizes. What lies on the disk is measured in
``resources.budget``. Why so: docs/how-to/storage.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import Kept


class StorageError(OracleError):
    """What is wanted does not fit, or a size makes no sense."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """What one run takes on disk, with graphs and features, by what is kept of it [B]."""

    full: int
    trimmed: int
    recipe: int

    def of(self, kept: Kept) -> int:
        """Return the size of a run of which so much is kept."""
        size: int = getattr(self, kept)
        return size


def plan(blocks: Mapping[int, Sequence[Sizes]], available: int) -> dict[int, Kept]:
    """Say what is kept of the runs of each block.

    All blocks keep the recipe; then the first ones, as many as fit, a trimmed bag; then the first
    ones, as many as fit, the full bag. All runs of a block keep the same, so that modes are never
    told apart by what was kept of them.

    Parameters
    ----------
    blocks
        The runs of each block, by what each would take.
    available
        What they may take together [B].

    Raises
    ------
    StorageError
        If not even all recipes fit; it says how many would.
    """
    kept: dict[int, Kept] = dict.fromkeys(sorted(blocks), "recipe")
    taken = sum(_size(blocks[block], "recipe") for block in kept)
    if taken > available:
        raise StorageError(_too_much(blocks, taken, available))
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


def _too_much(blocks: Mapping[int, Sequence[Sizes]], taken: int, available: int) -> str:
    fitting, room = 0, available
    for block in sorted(blocks):
        room -= _size(blocks[block], "recipe")
        if room < 0:
            break
        fitting += 1
    return (
        f"{len(blocks)} blocks of runs do not fit: graphs and features alone take "
        f"{megabytes(taken)} of the {megabytes(max(available, 0))} that there are for them. "
        f"Of these, the first {fitting} would fit; materialize fewer runs, raise "
        "ORACLE_STORAGE_BUDGET, free some space, or point ORACLE_HOME to another disk."
    )


def megabytes(size: int) -> str:
    """Return a size for people."""
    return f"{size / 1e6:.1f} MB"
