"""How often `oracle compare` is red in pull requests without a change, and names one of 10 %.

Runs of one goal are recorded once, below ``ORACLE_HOME``/pull_requests, and read once: of each
robot 420 of the usual build, and 100 blocks of each changed one. Every pull request draws from
them at random.

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
from typing import Any, NamedTuple

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

SEED, USUAL, RUNS, BLOCKS = 360_001, "usual", 420, 100
LEVEL = 0.005  # as action.yml
UNCHANGED, CHANGED = 800, 200  # pull requests; red ones without a change are rare
SIZES = (10, 40)  # recordings of each set, or pairs
TURTLEBOT3, CRAZYFLIE, ARM = "lidar_passthrough_odom", "cf_normal", "arm_normal"  # modes


class Change(NamedTuple):
    """A build with one parameter changed by 10 %, and globs of the features that it acts on."""

    mode: str
    name: str
    features: Sequence[str]
    parameter: str = ""  # of Nav2
    gains: float = 1.0  # of the low-level controllers, relative to the usual build


CHANGES = (
    Change(TURTLEBOT3, "speed limit", (
        "contextual.speed", "contextual.duration", "contextual.time_per_planned_metre",
        "navigation.p*", "navigation.command_*", "rate./*", "kinematics.travel*",
        "signals./cmd_vel*", "signals./odom/twist*",
    ), parameter="FollowPath.max_vel_x=0.234"),
    Change(TURTLEBOT3, "inflation radius", (
        "payload./*costmap*", "costmap.*", "contextual.clearance", "navigation.plan*",
        "navigation.lethal_*",
        "contextual.speed", "contextual.total_turning", "contextual.turning_per_metre",
        "signals./*costmap*", "signals./*plan*",
    ), parameter="inflation_radius=0.605"),
    Change(TURTLEBOT3, "PathDist.scale", (
        "navigation.command_*", "navigation.p*", "contextual.total_turning", "contextual.speed",
        "contextual.turning_per_metre", "contextual.clearance", "contextual.duration",
        "signals./cmd_vel*",
    ), parameter="FollowPath.PathDist.scale=35.2"),
    Change(CRAZYFLIE, "gains of the drone's PIDs", (
        "contextual.total_turning", "contextual.turning_per_metre", "contextual.yaw_rate_variance",
        "kinematics.t*", "signals./cf231/controller/*", "signals./cf231/motors/*",
        "signals./cf231/imu/*", "signals./cf231/odom/*",
    ), gains=1.1),
    Change(ARM, "gains of the arm's servos", (
        "kinematics.*", "signals./joint_trajectory_controller/*", "signals./joint_states/*",
    ), gains=1.1),
)  # fmt: skip


def rows() -> Iterator[Row]:
    """Yield the figures."""
    root = Path(os.environ.get("ORACLE_HOME") or "data") / "pull_requests"
    for mode in (TURTLEBOT3, CRAZYFLIE, ARM):
        usual = build(root / mode / USUAL, Change(mode, USUAL, ()), RUNS)
        for size in SIZES:
            red = [each.outcome == "different" for each in unchanged(usual, size)]
            name = f"{mode}, no change, {size} and {size} runs: red"
            yield _share(name, red, 1.0, at_most=True)
        for change in CHANGES:
            if change.mode == mode:
                yield from _named(usual, change, root / mode)


def _named(usual: Reference, change: Change, root: Path) -> Iterator[Row]:
    changed = build(root / change.name.replace(" ", "_"), change, BLOCKS)
    for size in SIZES:
        found = list(with_change(usual, changed, size))
        right = [names(each, change.features) for each in found]
        headlines = [each.differences[0].feature for each in found if each.differences]
        yield _share(f"{change.name}, {size} pairs: named correctly", right, 90.0,
                     at_most=False, remark=_most_frequent(headlines))  # fmt: skip


def build(root: Path, change: Change, runs: int) -> Reference:
    """Record the runs of one build and read them, unless both was done before."""
    kept = root / "reference.pickle"
    if kept.is_file():
        read: Reference = pickle.loads(kept.read_bytes())  # noqa: S301 -- written below
        return read
    nav2 = named_values([change.parameter] if change.parameter else [])
    campaign = Campaign(seed=SEED, goals_per_run=1, options=Options(nav2_params=nav2))
    for run in range(runs):
        recipe: Any = recipe_for(change.mode, run, campaign)
        if change.gains != 1.0:
            session = replace(recipe.session, gains=change.gains * recipe.session.gains)
            recipe = replace(recipe, session=session)
        record_run(recipe, RunDirectory(root, change.mode, run))
    read = read_reference([root], build_manager())
    kept.write_bytes(pickle.dumps(read))
    return read


def unchanged(usual: Reference, size: int) -> Iterator[SetComparison]:
    """Yield the comparisons of pull requests without a change."""
    rng = np.random.default_rng(0)
    for _ in range(UNCHANGED):
        drawn = rng.permutation(len(usual.table))[: 2 * size]
        yield compare(_some(usual, drawn[:size]), _some(usual, drawn[size:]), LEVEL)


def with_change(usual: Reference, changed: Reference, size: int) -> Iterator[SetComparison]:
    """Yield the comparisons of pull requests with a change, in pairs of equal blocks."""
    rng = np.random.default_rng(0)
    place = {block: row for row, block in enumerate(usual.table["block"])}
    shared = [
        (place[block], row) for row, block in enumerate(changed.table["block"]) if block in place
    ]
    for _ in range(CHANGED):
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
    interval = f"(95 %: {100 * rate.low:.3g} to {100 * rate.high:.3g} %)"
    return Row(name, 100.0 * rate.value, "%", goal, at_most, f"{interval} {remark}".rstrip())


def _most_frequent(features: Sequence[str]) -> str:
    found, count = np.unique(features, return_counts=True)
    return f"mostly {found[count.argmax()]}" if len(found) else ""
