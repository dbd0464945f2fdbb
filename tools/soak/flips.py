"""Flip bits in recordings and tables, one at a time: each flip must be noticed or harmless.

``python -m tools.soak.flips`` flips bits in the bag (MCAP and SQLite), the graphs and the manifest
of a run, in its feature tables and in the joined table. After each flip it computes or reads
features. They must be unchanged, or an error must name the damaged file. The test suite does the
same with fewer flips.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from assets.worker.run import process_run
from assets.worker.run_job import OF_A_RUN, RunJob
from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.datasets import feature_dataset, read_table, write_table
from oracle_pipeline.features import FeatureManager, build_manager, extract
from oracle_pipeline.opened_run import open_run
from sim.campaigns import Campaign

MODE = "atc_normal"
TIMEOUT_S = 20.0  # of simulated time: two graphs, and a bag of several chunks

Features = Callable[[], list[pd.DataFrame]]


@dataclass(frozen=True, slots=True)
class Target:
    """Files that belong together, and how features are obtained from them."""

    name: str
    files: tuple[Path, ...]
    features: Features


@dataclass(slots=True)
class Tally:
    """The results of the flips in one target."""

    caught: int = 0
    harmless: int = 0  # the same features
    unnoticed: list[str] = field(default_factory=list)  # other features, or a crash: file and bit

    @property
    def tried(self) -> int:
        """Number of bits that were flipped."""
        return self.caught + self.harmless + len(self.unnoticed)


def flip_bits(target: Target, count: int, rng: np.random.Generator) -> Tally:
    """Flip bits of a target's files, drawn uniformly; each is restored afterwards."""
    tally = Tally()
    expected = target.features()
    sizes = np.array([file.stat().st_size for file in target.files])
    for _ in range(count):
        file = target.files[rng.choice(len(sizes), p=sizes / sizes.sum())]
        content = file.read_bytes()
        bit = int(rng.integers(8 * len(content)))
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << bit % 8
        file.write_bytes(flipped)
        try:
            found = target.features()
        except OracleError:
            tally.caught += 1
        except Exception as error:  # a parser that does not handle it
            tally.unnoticed.append(f"{file}, bit {bit}: {error!r}")
        else:
            if _same(found, expected):
                tally.harmless += 1
            else:
                tally.unnoticed.append(f"{file}, bit {bit}: other features")
        finally:
            file.write_bytes(content)
    return tally


def _same(found: Sequence[pd.DataFrame], expected: Sequence[pd.DataFrame]) -> bool:
    return len(found) == len(expected) and all(
        one.equals(other) and one.attrs == other.attrs
        for one, other in zip(found, expected, strict=True)
    )


def targets_of(run: RunDirectory, manager: FeatureManager) -> Iterator[Target]:
    """Return the targets of a run and its tables."""
    tables = [run.feature_table(table) for table in ("run", "window")]

    def of_recording(path: Path) -> Features:
        return lambda: _features(path, manager)

    yield Target("bag", tuple(run.bag.iterdir()), of_recording(run.path))
    for file in run.bag.glob("*.mcap"):
        yield Target("MCAP file alone", (file,), of_recording(file))
    yield Target("graphs", tuple(run.graphs.glob("0*.gexf")), of_recording(run.path))
    yield Target("manifest", (run.manifest_path,), of_recording(run.path))
    yield Target("feature tables", tuple(tables), lambda: list(map(read_table, tables)))


def _features(path: Path, manager: FeatureManager) -> list[pd.DataFrame]:
    with open_run(path) as opened:
        extracted = extract(opened, manager)
    return [extracted.run, extracted.windows]


def made(root: Path) -> Iterator[tuple[str, Target]]:
    """Record a run with each storage, make a joined table, and yield their targets."""
    manager = build_manager()
    rows = []
    for storage in ("mcap", "sqlite3"):
        run = RunDirectory(root / storage, MODE, 0)
        campaign = Campaign(timeout_s=TIMEOUT_S, storage=storage)
        process_run(RunJob(run, campaign, OF_A_RUN, refresh=False))
        yield from ((storage, target) for target in targets_of(run, manager))
        rows.append(read_table(run.feature_table("run")).assign(run_id=storage))
    joined = root / "features.parquet"
    write_table(feature_dataset(rows), joined)
    yield "both", Target("joined table", (joined,), lambda: [read_table(joined)])


def main() -> None:
    """Flip bits one at a time, and print whether any flip went unnoticed."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak.flips", description=main.__doc__)
    parser.add_argument("--flips", type=int, default=500, help="in each target")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    unnoticed: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for storage, target in made(Path(folder)):
            tally = flip_bits(target, arguments.flips, rng)
            print(
                f"{target.name} ({storage}): {tally.tried} flips, {tally.caught} caught, "
                f"{tally.harmless} harmless, {len(tally.unnoticed)} unnoticed",
                flush=True,
            )
            unnoticed += tally.unnoticed
    print("\n".join(unnoticed) or "No flip went unnoticed.")
    sys.exit(bool(unnoticed))


if __name__ == "__main__":
    main()
