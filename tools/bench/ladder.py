"""The attacker ladder: how well attacks are detected by how much the attacker controls.

Pairs of runs are recorded in closed loop. Further attacks are applied to the normal runs while
their features are extracted. A rung is a set of topics that are left in the bag. Scores are those
of reference cards of other blocks. Beside the score stands that of tampering alone.
``ORACLE_BENCH_RUNS`` names a folder to keep the runs in, ``ORACLE_BENCH_BLOCKS`` the number of
blocks.
"""

import os
import tempfile
from collections.abc import Collection, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline import features
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bootstrap import DistinctRuns
from oracle_pipeline.datasets import feature_dataset, is_malicious, window_dataset
from oracle_pipeline.evaluation.card_verdicts import card_folds, card_verdicts
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.metrics import auc
from oracle_pipeline.scoring.measured_runs import MeasuredRuns
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run
from tools.bench.alterations import (
    FIVE,
    IMU,
    JOINTS,
    ODOMETRY,
    POSE,
    SCAN,
    TRANSFORMS,
    Alteration,
    blinded,
    frozen,
    localisation,
    noisy,
    odometry,
    open_altered,
    phantom,
    ranges_by,
    replayed,
    scaled,
    transforms,
    without_small_things,
)
from tools.bench.figures import Row

CONTROL, FAKE, REAL = "lidar_passthrough_odom", "fake_object", "benign_obstacle"
GOALS = 2
BLOCKS = 24
SEED = 17

_ATTACKED, _SOURCE, _OTHER = "/scan_fakeobject", "/scan_tom", "/scan"
GOAL = 0.95


@dataclass(frozen=True)
class Rung:
    """The topics that an attacker leaves in the bag."""

    name: str
    left_out: tuple[str, ...]


WHOLE = Rung("input still in the bag", ())
GONE = Rung("input not in the bag", (_SOURCE,))
ALONE = Rung("one scanner only", (_SOURCE, _OTHER, "/range_ella"))
TWO = Rung("two scanners together", (_SOURCE, "/range_ella"))


@dataclass(frozen=True)
class Attack:
    """An alteration of normal runs on a rung; without an alteration, an attacked mode."""

    name: str
    rung: Rung
    alteration: Alteration | None = None
    goal: float | None = None


_BASE, _ODOM, _MOUNT = "base_footprint", "odom", "base_scan"
_RATES = scaled(*(("angular_velocity", axis) for axis in "xyz"))
_FORCES = scaled(*(("linear_acceleration", axis) for axis in "xyz"))
_WHEELS = scaled(("position",), ("velocity",))


def _of_frame(child: str, **how: float) -> Alteration:
    return Alteration({TRANSFORMS: transforms(child, **how)})


ATTACKS = (
    Attack("fake object", WHOLE, goal=GOAL),
    Attack("fake object", GONE, goal=GOAL),
    Attack("fake object", ALONE, goal=GOAL),
    Attack("fake object, noisy, exact", ALONE, phantom(1.0, 0.2, 0.01)),
    Attack("fake object, noisy, exact", TWO, phantom(1.0, 0.2, 0.01)),
    Attack("fake object, exact", TWO, phantom(1.0, 0.2, 0.0)),
    Attack("scans of 5 s earlier", ALONE, replayed(25)),
    Attack("scans frozen", ALONE, frozen()),
    Attack("scans turned by 3 degrees", ALONE, ranges_by(lambda m: np.roll(m.ranges, 3))),
    Attack("nearest small object removed", ALONE, ranges_by(without_small_things)),
    Attack("ranges 5 % longer", ALONE, ranges_by(lambda m: m.ranges * FIVE)),
    Attack("ranges 5 cm longer", ALONE, ranges_by(lambda m: m.ranges + 0.05)),
    Attack("ranges with noise of 2 %", ALONE, ranges_by(noisy)),
    Attack("60 degrees ahead blinded", ALONE, ranges_by(blinded)),
    Attack("scans delayed by 0.3 s", ALONE, Alteration(late_s={SCAN: 0.3}, onset_s=15.0)),
    Attack("scans of 0.4 s earlier", ALONE, replayed(2)),
    Attack("odometry 5 %", WHOLE, Alteration({ODOMETRY: odometry(along=FIVE, twist=FIVE)}), GOAL),
    Attack("odometry's turn 5 %", WHOLE, Alteration({ODOMETRY: odometry(turn=FIVE)}), GOAL),
    Attack("odometry's twist 5 %", WHOLE, Alteration({ODOMETRY: odometry(twist=FIVE)}), GOAL),
    Attack("odometry 5 cm", WHOLE, Alteration({ODOMETRY: odometry(east_m=0.05)}), GOAL),
    Attack(
        "odometry and tf 5 %", WHOLE,
        Alteration({
            ODOMETRY: odometry(along=FIVE, twist=FIVE), TRANSFORMS: transforms(_BASE, along=FIVE)
        }), GOAL,
    ),
    Attack(
        "odometry and tf 5 cm, from 15 s on", WHOLE,
        Alteration({
            ODOMETRY: odometry(east_m=0.05), TRANSFORMS: transforms(_BASE, east_m=0.05)
        }, onset_s=15.0), GOAL,
    ),
    Attack(
        "odometry and tf drift 1 cm/s, from 15 s on", WHOLE,
        Alteration({
            ODOMETRY: odometry(aside_m_s=0.01), TRANSFORMS: transforms(_BASE, aside_m_s=0.01)
        }, onset_s=15.0),
    ),
    Attack(
        "odometry, tf and joints 5 %", WHOLE,
        Alteration({
            ODOMETRY: odometry(along=FIVE, twist=FIVE),
            TRANSFORMS: transforms(_BASE, along=FIVE), JOINTS: _WHEELS,
        }), GOAL,
    ),
    Attack("tf of odometry 5 %", WHOLE, _of_frame(_BASE, along=FIVE), GOAL),
    Attack("tf of odometry 5 cm", WHOLE, _of_frame(_BASE, east_m=0.05), GOAL),
    Attack("tf of localisation 5 cm", WHOLE, _of_frame(_ODOM, east_m=0.05), GOAL),
    Attack("localisation 5 cm", WHOLE, Alteration({POSE: localisation(0.05)}), GOAL),
    Attack("gyroscope 5 %", WHOLE, Alteration({IMU: _RATES}), GOAL),
    Attack("accelerometer 5 %", WHOLE, Alteration({IMU: _FORCES}), GOAL),
    Attack("joints 5 %", WHOLE, Alteration({JOINTS: _WHEELS}), GOAL),
    Attack("one joint 5 %", WHOLE, Alteration({JOINTS: scaled(("position",), only=0)}), GOAL),
    Attack("mount of one scanner 5 cm", WHOLE, _of_frame(_MOUNT, east_m=0.05), GOAL),
    Attack("odometry delayed by 0.1 s", WHOLE, Alteration(late_s={ODOMETRY: 0.1})),
)  # fmt: skip


def rows() -> Iterator[Row]:
    """Yield a figure for each attack, and for the fake object against real ones."""
    kept = os.environ.get("ORACLE_BENCH_RUNS")
    blocks = range(int(os.environ.get("ORACLE_BENCH_BLOCKS", BLOCKS)))
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor() as pool:
        root = Path(kept or folder)
        list(pool.map(_record, [(root, mode, b) for mode in (CONTROL, FAKE, REAL) for b in blocks]))
        ways = {b: RunDirectory(root, REAL, b).manifest().outcome for b in blocks}
        passed = [block for block, outcome in ways.items() if outcome == "succeeded"]
        right: dict[Rung, Tables] = {}
        for number, attack in enumerate(ATTACKS):
            if attack.rung not in right:
                right[attack.rung] = Tables.of(
                    pool.map(
                        _right, [(root, attack.rung, m, b) for m in (CONTROL, REAL) for b in blocks]
                    )
                )
            attacked = Tables.of(pool.map(_attacked, [(root, number, b) for b in blocks]))
            yield from _figures(attack, right[attack.rung], attacked, passed)


@dataclass(frozen=True)
class Tables:
    """Features of some runs."""

    runs: list[pd.DataFrame]
    windows: list[pd.DataFrame]

    @classmethod
    def of(cls, tables: Iterator[features.FeatureTables]) -> "Tables":
        """Collect the features of runs."""
        found = list(tables)
        return cls([each.run for each in found], [each.windows for each in found])


def _record(task: tuple[Path, str, int]) -> None:
    root, mode, block = task
    directory = RunDirectory(root, mode, block)
    if not directory.path.exists():
        record_run(recipe_for(mode, block, Campaign(goals_per_run=GOALS)), directory)


def _right(task: tuple[Path, Rung, str, int]) -> features.FeatureTables:
    root, rung, mode, block = task
    return _extract(root, mode, block, Alteration(), rung)


def _attacked(task: tuple[Path, int, int]) -> features.FeatureTables:
    root, number, block = task
    attack = ATTACKS[number]
    mode = FAKE if attack.alteration is None else CONTROL
    tables = _extract(root, mode, block, attack.alteration or Alteration(), attack.rung)
    for table in (tables.run, tables.windows):
        table["mode"], table["label"] = "attacked", "malicious"
        table["run_id"] = f"attacked|run{block:03d}"
    return tables


def _extract(
    root: Path, mode: str, block: int, alteration: Alteration, rung: Rung
) -> features.FeatureTables:
    path = RunDirectory(root, mode, block).path
    with open_altered(path, alteration, rung.left_out) as run:
        return features.extract(run, features.build_manager())


def _figures(
    attack: Attack, right: Tables, attacked: Tables, passed: Collection[int]
) -> Iterator[Row]:
    """Yield the figures of an attack; in some blocks the robot passed the real obstacle."""
    df = feature_dataset([*right.runs, *attacked.runs])
    runs = MeasuredRuns.ordered(df, window_dataset([*right.windows, *attacked.windows]))
    judged = card_verdicts(runs, card_folds(runs.features, SEED))
    score, tampering = (judged.scores(aspect).score for aspect in ("", "tampering"))
    mode, attacked_run = runs.features["mode"].to_numpy(), is_malicious(runs.features)
    against = {"control": (mode == CONTROL, attack.goal)}
    if attack.alteration is None:
        is_passed = runs.features["block"].isin(passed).to_numpy()
        against["real obstacle"] = (mode == REAL, 0.90)
        against["real obstacle that was passed"] = ((mode == REAL) & is_passed, 0.90)
    for what, (negative, goal) in against.items():
        two = negative | attacked_run
        estimate, of_tampering = (_auc(each[two], runs, two) for each in (score, tampering))
        yield Row(
            f"{attack.rung.name}: {attack.name} against {what}", estimate.value, "AUC", goal, False,
            f"[{estimate.low:.2f}, {estimate.high:.2f}]; tampering {of_tampering}",
        )  # fmt: skip


def _auc(
    score: NDArray[np.float64], runs: MeasuredRuns, chosen_rows: NDArray[np.bool_]
) -> Estimate:
    chosen = runs.features[chosen_rows]
    distinct = DistinctRuns(
        np.arange(len(chosen)),
        np.ones(len(chosen), np.int64),
        is_malicious(chosen),
        chosen["block"].to_numpy(),
    )
    return auc(score, distinct, np.random.default_rng(SEED))
