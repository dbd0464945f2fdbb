"""How often `oracle compare` is red in pull requests without a change, and names one of 10 %.

Runs of one goal are recorded once, below ``ORACLE_HOME``/pull_requests, and read once: 420 of the
usual build, and 100 blocks of each changed one. Every pull request draws from them at random.

Without a change: two disjoint sets of usual runs, of other blocks, so every difference is a false
one. With a change: some blocks of the usual build, and the same blocks of the changed one, as in
CI with a simulator. A change is named correctly if the headline of the comment is a feature that
the parameter acts on by its meaning; `CHANGES` lists them, and was written before any comparison.
"""

import os
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.comparison.set_comparison import SetComparison, compare
from oracle_pipeline.evaluation.estimate import clopper_pearson
from oracle_pipeline.features import build_manager
from oracle_pipeline.scoring.reference import Reference, read_reference
from sim.campaigns import Campaign, Options
from sim.experiments import recipe_for, record_run
from sim.nav2.parameters import named_values
from tools.bench.figures import Row

MODE, SEED = "lidar_passthrough_odom", 360_001
USUAL, RUNS, BLOCKS = "usual", 420, 100
REQUESTS, LEVEL = 200, 0.01
SIZES = (10, 40)  # recordings of each set, or pairs


class Change(NamedTuple):
    """A build with one parameter changed by 10 %, and globs of the features that it acts on."""

    name: str
    parameter: str
    features: Sequence[str]


CHANGES = (
    Change("speed limit", "FollowPath.max_vel_x=0.234", (
        "contextual.speed", "contextual.duration", "contextual.time_per_planned_metre",
        "navigation.p*", "navigation.command_*", "rate./*", "kinematics.travel*",
    )),
    Change("inflation radius", "inflation_radius=0.605", (
        "payload./*costmap*", "costmap.*", "contextual.clearance", "navigation.plan*",
        "navigation.lethal_*",
        "contextual.speed", "contextual.total_turning", "contextual.turning_per_metre",
    )),
    Change("controller gain", "FollowPath.PathDist.scale=35.2", (
        "navigation.command_*", "navigation.p*", "contextual.total_turning", "contextual.speed",
        "contextual.turning_per_metre", "contextual.clearance", "contextual.duration",
    )),
)  # fmt: skip


def rows() -> Iterator[Row]:
    """Yield the figures."""
    root = Path(os.environ.get("ORACLE_HOME") or "data") / "pull_requests"
    usual = build(root / USUAL, "", RUNS)
    for size in SIZES:
        red = [each.outcome == "different" for each in unchanged(usual, size)]
        yield _share(f"no change, {size} and {size} runs: red", red, 1.0, at_most=True)
    for change in CHANGES:
        changed = build(root / change.name.replace(" ", "_"), change.parameter, BLOCKS)
        for size in SIZES:
            found = list(with_change(usual, changed, size))
            right = [names(each, change.features) for each in found]
            headlines = [each.differences[0].feature for each in found if each.differences]
            yield _share(f"{change.name}, {size} pairs: named correctly", right, 90.0,
                         at_most=False, remark=_most_frequent(headlines))  # fmt: skip


def build(root: Path, parameter: str, runs: int) -> Reference:
    """Record the runs of one build and read them, unless both was done before."""
    kept = root / "reference.pickle"
    if kept.is_file():
        read: Reference = pickle.loads(kept.read_bytes())  # noqa: S301 -- written below
        return read
    options = Options(nav2_params=named_values([parameter] if parameter else []))
    campaign = Campaign(seed=SEED, goals_per_run=1, options=options)
    for run in range(runs):
        record_run(recipe_for(MODE, run, campaign), RunDirectory(root, MODE, run))
    read = read_reference([root], build_manager())
    kept.write_bytes(pickle.dumps(read))
    return read


def unchanged(usual: Reference, size: int) -> Iterator[SetComparison]:
    """Yield the comparisons of pull requests without a change."""
    rng = np.random.default_rng(0)
    for _ in range(REQUESTS):
        drawn = rng.permutation(len(usual.table))[: 2 * size]
        yield compare(_some(usual, drawn[:size]), _some(usual, drawn[size:]), LEVEL)


def with_change(usual: Reference, changed: Reference, size: int) -> Iterator[SetComparison]:
    """Yield the comparisons of pull requests with a change, in pairs of equal blocks."""
    rng = np.random.default_rng(0)
    place = {block: row for row, block in enumerate(usual.table["block"])}
    shared = [
        (place[block], row) for row, block in enumerate(changed.table["block"]) if block in place
    ]
    for _ in range(REQUESTS):
        before, after = np.array(shared)[rng.permutation(len(shared))[:size]].T
        yield compare(_some(usual, before), _some(changed, after), LEVEL)


def names(comparison: SetComparison, features: Sequence[str]) -> bool:
    """Return whether the headline of a comparison is one of some features, given as globs."""
    headline = next((each.feature for each in comparison.differences), "")
    return any(fnmatchcase(headline, glob) for glob in features)


def _some(reference: Reference, rows: NDArray[np.intp]) -> Reference:
    """Return a reference with some of its recordings."""
    table = reference.table.iloc[rows].reset_index(drop=True)
    observations = tuple(reference.observations[row] for row in rows)
    return replace(reference, table=table, observations=observations, notes=())


def _share(name: str, hits: Sequence[bool], goal: float, *, at_most: bool, remark: str = "") -> Row:
    rate = clopper_pearson(float(np.mean(hits)), len(hits))
    interval = f"(95 %: {100 * rate.low:.2g} to {100 * rate.high:.2g} %)"
    return Row(name, 100.0 * rate.value, "%", goal, at_most, f"{interval} {remark}".rstrip())


def _most_frequent(features: Sequence[str]) -> str:
    found, count = np.unique(features, return_counts=True)
    return f"mostly {found[count.argmax()]}" if len(found) else ""
