"""Storage used below a local root, expected sizes of further runs, and the storage plan.

The pipeline plans with it before it starts runs; ``oracle-sim storage`` shows it.
"""

import os
import shutil
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from pydantic import ByteSize, TypeAdapter, ValidationError

from oracle_pipeline.bags.layout import FEATURES, owner
from oracle_pipeline.bags.manifest import KEPT, Kept
from oracle_pipeline.bags.run_directory import BAG_FOLDER, RunDirectory, find_runs
from resources.storage.plan import Sizes, StorageError, megabytes, plan

BUDGET_VARIABLE = "ORACLE_STORAGE_BUDGET"

# First guess of the size of a run: a fixed part, and a part for each goal.
FIRST_GUESS = Sizes(full=1_500_000, trimmed=1_000_000, recipe=900_000)
FIRST_GUESS_A_GOAL = Sizes(full=3_000_000, trimmed=1_100_000, recipe=250_000)
TRIMMED_SHARE = 0.3  # of a bag, until one has been trimmed
JOINED_SHARE = 0.1  # of the tables of a run, once they are joined with those of a partition
SAMPLE = 20  # finished runs of a mode to average for the expected size
AMPLE = 4  # multiple of the expected size; if it fits, no plan is needed
MARGIN = 0.05  # share of the limit reserved for larger runs and for reports


@dataclass(frozen=True, slots=True)
class RunBytes:
    """Storage of a finished run [B]."""

    bag: int
    tables: int  # features, unless they are joined with those of other runs
    rest: int  # graphs, manifest, picture

    @property
    def total(self) -> int:
        """All of it."""
        return self.bag + self.tables + self.rest


@dataclass(frozen=True, slots=True)
class Stock:
    """Storage used below a root."""

    total: int  # [B]
    free: int  # on its disk [B]
    runs: Mapping[RunDirectory, RunBytes]  # the finished ones, by mode and number


@dataclass(frozen=True, slots=True)
class StoragePlan:
    """How much to keep of which runs, based on the sizes known so far.

    Attributes
    ----------
    kept
        How much to keep of the runs of each block.
    expected
        Size of a run of each mode that is not recorded yet.
    shrink
        Finished runs that were not requested and have more than their block should keep.
    blocks_ahead
        Number of blocks to record before planning again with better known sizes.
    taken, limit
        Storage used below the root when the plan was made, and its limit [B].
    """

    kept: Mapping[int, Kept]
    expected: Mapping[str, Sizes]
    shrink: tuple[RunDirectory, ...]
    blocks_ahead: int
    taken: int
    limit: int

    def __str__(self) -> str:
        """Return the plan in one line."""
        runs = Counter(self.kept.values())
        blocks = ", ".join(f"{runs[kept]} {kept}" for kept in KEPT if runs[kept])
        return f"{megabytes(self.taken)} of {megabytes(self.limit)} used; blocks to keep: {blocks}"


def parse_budget(text: str) -> int | None:
    """Return a budget in bytes; None if it is empty.

    Raises
    ------
    StorageError
        If it is not a number of bytes, with or without a unit.
    """
    if not text.strip():
        return None
    try:
        return int(TypeAdapter(ByteSize).validate_python(text.strip()))
    except ValidationError as error:
        raise StorageError(
            f"{BUDGET_VARIABLE} is {text!r}; give a number of bytes, for example 20GiB or 500MB."
        ) from error


def take_stock(root: Path) -> Stock:
    """Measure everything below a root in one pass."""
    total = 0
    parts: defaultdict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    for folder, _, names in os.walk(root):
        place = Path(folder).relative_to(root).parts
        for name in names:
            size = _bytes_on_disk(os.path.join(folder, name))  # noqa: PTH118 -- for speed
            total += size
            if (of := owner((*place, name))) is not None:
                parts[of.mode, of.run_id][of.part] += size
    runs = {}
    for run in find_runs(root):
        sizes = parts[run.mode, run.run_id]
        bag, tables = sizes[BAG_FOLDER], sizes[FEATURES]
        runs[run] = RunBytes(bag, tables, sizes.total() - bag - tables)
    return Stock(total, shutil.disk_usage(root).free, runs)


def _bytes_on_disk(path: str) -> int:
    try:
        status = os.stat(path)  # noqa: PTH116
    except FileNotFoundError:  # a run was renamed into place meanwhile
        return 0
    return max(status.st_size, 512 * status.st_blocks)


def make_plan(
    root: Path, wanted: Collection[RunDirectory], *, budget: int | None, reserve: int, workers: int,
    goals: int, together: int = 1,
) -> StoragePlan:  # fmt: skip
    """Plan the storage of requested and finished runs.

    Parameters
    ----------
    root
        A local folder.
    wanted
        All requested runs, finished or not.
    budget
        Limit for everything below the root [B]; None: the size of the disk.
    reserve
        Space that stays free on the disk [B].
    workers
        Number of runs that are simulated at the same time, each with its complete bag.
    goals
        Goals of a run, for a first estimate.
    together
        Number of runs of a partition, whose tables are joined once all are finished.

    Raises
    ------
    StorageError
        If graphs and features alone do not fit.
    """
    stock = take_stock(root)
    capacity = stock.total + stock.free - reserve
    limit = capacity if budget is None else min(budget, capacity)
    new = [run for run in wanted if run not in stock.runs]
    guess = Sizes(*(FIRST_GUESS.of(kept) + goals * FIRST_GUESS_A_GOAL.of(kept) for kept in KEPT))
    share = JOINED_SHARE if together > 1 else 1.0
    modes = sorted({run.mode for run in new})
    expected = {mode: expected_sizes(mode, stock, share) or guess for mode in modes}
    room, ample_room = _working_rooms(new, expected, workers)
    tables = [run.tables for run in stock.runs.values() if run.tables] or [0]
    waiting = round((1.0 - share) * fmean(tables) * min(len(wanted), together * len(modes)))
    needed = sum(expected[run.mode].full for run in new)
    if AMPLE * needed + ample_room <= limit - stock.total:
        blocks = sorted({run.run for run in wanted})
        return StoragePlan(
            dict.fromkeys(blocks, "full"), expected, (), len(blocks), stock.total, limit
        )

    finished = {run: _possible_sizes(run, stock, share) for run in stock.runs}
    takes: defaultdict[int, list[Sizes]] = defaultdict(list)
    for run in new:
        takes[run.run].append(expected[run.mode])
    for run, (_, sizes) in finished.items():
        takes[run.run].append(sizes)
    others = stock.total - sum(run.total for run in stock.runs.values())
    fewest_finished = _fewest_finished(expected, stock)
    available = int(limit * (1.0 - MARGIN)) - others - waiting
    try:
        kept = _fullest(takes, available - ample_room, available - room)
    except StorageError:
        # The first guess may be wrong: if a few runs fit, record and measure them.
        if fewest_finished or limit - stock.total < workers * guess.recipe:
            raise
        kept = dict.fromkeys(sorted(takes), "recipe")
    requested = set(wanted)
    shrink = tuple(
        run
        for run, (has, sizes) in finished.items()
        if run not in requested and sizes.of(kept[run.run]) < sizes.of(has)
    )
    return StoragePlan(kept, expected, shrink, max(1, fewest_finished), stock.total, limit)


def _fewest_finished(modes: Collection[str], stock: Stock) -> int:
    """Return the smallest number of finished runs of any of these modes."""
    finished = Counter(run.mode for run in stock.runs)
    return min((finished[mode] for mode in modes), default=len(stock.runs))


def expected_sizes(mode: str, stock: Stock, share: float = 1.0) -> Sizes | None:
    """Return the mean size of finished runs of the mode, or else of all modes.

    The share is that of their tables which counts.
    """
    of_mode = [run for run in stock.runs if run.mode == mode] or list(stock.runs)
    sample = of_mode[:: len(of_mode) // SAMPLE + 1]
    known = [(stock.runs[run], run.readable_manifest()) for run in sample]
    measured = [(size, manifest.measured) for size, manifest in known if manifest]
    if not measured:
        return None
    rest = fmean(size.rest + share * size.tables for size, _ in measured)
    bag = fmean(m.bytes[BAG_FOLDER] + m.freed_bytes for _, m in measured)
    trimmed = [float(m.bytes[BAG_FOLDER]) for _, m in measured if m.kept == "trimmed"]
    smaller = fmean(trimmed) if trimmed else TRIMMED_SHARE * bag
    return Sizes(round(rest + bag), round(rest + smaller), round(rest))


def _working_rooms(
    new: Sequence[RunDirectory], expected: Mapping[str, Sizes], workers: int
) -> tuple[int, int]:
    """Return the temporary storage that runs need while they are recorded, and an ample one.

    Besides what is kept of a run, its complete bag is there until its features are extracted. With
    ample room, all runs that are recorded at the same time may be of the largest mode, or larger
    than expected.
    """
    sizes = sorted((expected[run.mode] for run in new), key=lambda size: size.recipe - size.full)
    largest = max((size.full + size.trimmed for size in sizes), default=0)
    at_once = sizes[:workers]
    return sum(size.full - size.recipe for size in at_once), len(at_once) * largest


def _fullest(
    takes: Mapping[int, Sequence[Sizes]], preferred: int, available: int
) -> dict[int, Kept]:
    """Return the plan that fits into the preferred storage, or else into what is available."""
    try:
        return plan(takes, preferred)
    except StorageError:
        return plan(takes, available)


def _possible_sizes(run: RunDirectory, stock: Stock, share: float) -> tuple[Kept, Sizes]:
    """Return how much is kept of a finished run, and its sizes if less were kept."""
    from sim.experiments import can_be_rebuilt  # the testbeds: half a second to import

    now = stock.runs[run]
    rest = now.rest + round(share * now.tables)
    whole = now.bag + rest
    fixed = Sizes(whole, whole, whole)
    if now.bag == 0:
        return "recipe", fixed
    manifest = run.readable_manifest()
    if manifest is None or not can_be_rebuilt(manifest):
        return "full", fixed
    has = manifest.measured.kept
    trimmed = now.bag if has == "trimmed" else round(TRIMMED_SHARE * now.bag)
    return has, Sizes(whole, rest + trimmed, rest)


def storage_of_modes(stock: Stock) -> list[dict[str, str | int]]:
    """Return the used and freed storage of each mode, as rows of a table."""
    by_mode: defaultdict[str, list[RunDirectory]] = defaultdict(list)
    for run in stock.runs:
        by_mode[run.mode].append(run)
    rows: list[dict[str, str | int]] = []
    for mode, runs in by_mode.items():
        measured = [m.measured for run in runs if (m := run.readable_manifest())]
        rows.append(
            {
                "mode": mode,
                **{kept: sum(m.kept == kept for m in measured) for kept in KEPT},
                "on disk": megabytes(sum(stock.runs[run].total for run in runs)),
                "freed": megabytes(sum(m.freed_bytes for m in measured)),
            }
        )
    return rows
