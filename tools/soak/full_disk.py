"""Materialize each asset while files cannot grow, as on a full disk. Nothing may be lost.

``python -m tools.soak.full_disk`` simulates a small campaign. Then it materializes each asset again
with a limit on file sizes, drawn below the size of the largest file that the asset writes.
"""

import argparse
import contextlib
import hashlib
import resource
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from assets.aggregates import DATASET
from assets.worker.run import process_run
from assets.worker.run_job import RECORDED, RunJob
from assets.worker.run_job import TABLES as FEATURES
from oracle_pipeline.bags.layout import TABLES
from oracle_pipeline.bags.run_directory import RunDirectory
from resources.store import RunStore
from sim.campaigns import Campaign
from tools.soak.aggregates import AGGREGATES, REPORTS, RUNS, compared, made, make_campaign, state
from tools.soak.faults import leftovers

TIMES = 3  # per asset


@contextlib.contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Limit the size of files, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def aggregate(root: Path, asset: str, rng: np.random.Generator) -> list[str]:
    """Materialize an asset over all runs on a full disk, and return the faults."""
    store = RunStore(root=str(root))
    if asset in REPORTS:
        outputs = list(store.results(asset).rglob("*"))
    else:
        outputs = [store.report] if asset == "oracle_report" else [store.dataset(DATASET)]
    expected = state(root)
    success = False
    try:
        with largest_file(_limit(outputs, rng)):
            success = made(root, asset).success
    except Exception as error:  # Dagster's own database may be the first that cannot grow
        print(f"expected: {type(error).__name__}: {error}"[:200])
    wrong = [f"{asset} was written on a full disk"] if success else []
    return wrong + compared(root, expected)


def recording(run: RunDirectory, rng: np.random.Generator) -> list[str]:
    """Record a run again on a full disk, and return the faults."""
    return _of_run(run, frozenset(RECORDED), list(run.bag.iterdir()), rng)


def features(run: RunDirectory, rng: np.random.Generator) -> list[str]:
    """Extract the features of a run again on a full disk, and return the faults."""
    tables = [run.feature_table(table) for table in TABLES]
    return _of_run(run, frozenset(FEATURES), tables, rng)


def _of_run(
    run: RunDirectory, wanted: frozenset[str], outputs: list[Path], rng: np.random.Generator
) -> list[str]:
    before = _hashes(run.root)
    wrong = []
    try:
        with largest_file(_limit(outputs, rng)):
            process_run(RunJob(run, Campaign(goals_per_run=1), wanted, refresh=True))
        wrong.append(f"{run.key} was written on a full disk")
    except Exception as error:
        print(f"expected: {type(error).__name__}: {error}"[:200])
    after = _hashes(run.root)
    wrong += [f"{name} changed" for name in before | after if before.get(name) != after.get(name)]
    return wrong + [f"{name} was left behind" for name in leftovers(run.root)]


def _limit(outputs: list[Path], rng: np.random.Generator) -> int:
    """Draw a size below that of the largest file [bytes]."""
    return int(rng.integers(max(file.stat().st_size for file in outputs if file.is_file())))


def _hashes(root: Path) -> dict[str, str]:
    return {
        str(file.relative_to(root)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in root.rglob("*")
        if file.is_file()
    }


def everything(
    root: Path, rng: np.random.Generator, aggregates: Iterable[str] = AGGREGATES
) -> Iterator[tuple[str, list[str]]]:
    """Materialize each asset once on a full disk; yield its name and its faults."""
    run = RunDirectory(root, *RUNS[0])
    yield "recording of a run", recording(run, rng)
    yield "features of a run", features(run, rng)
    for asset in aggregates:
        yield asset, aggregate(root, asset, rng)


def main() -> None:
    """Materialize each asset on a full disk, and print whether anything was lost or damaged."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.soak.full_disk", description=main.__doc__
    )
    parser.add_argument("--times", type=int, default=TIMES)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    found: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        make_campaign(Path(folder))
        for _ in range(arguments.times):
            for asset, wrong in everything(Path(folder), rng):
                print(f"{asset}: {'; '.join(wrong) or 'no faults'}", flush=True)
                found += wrong
    print("\n".join(found) or "Nothing was lost or damaged.")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
