"""How often `oracle compare` finds a difference between runs of one build, and between two builds.

One build: random splits of the normal runs of a campaign into ten and ten, which is the campaign
below ``ORACLE_HOME``. Two builds: ten runs of one goal each, recorded here, that differ in one
parameter of Nav2.
"""

import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.comparison.set_comparison import compare
from oracle_pipeline.evaluation.estimate import clopper_pearson
from oracle_pipeline.features import build_manager
from oracle_pipeline.scoring.reference import Reference, read_reference
from sim.campaigns import Campaign, Options
from sim.experiments import recipe_for, record_run
from sim.nav2.parameters import named_values
from tools.bench.figures import Row

SPLITS, EACH = 100, 10  # runs in each set
SPLIT_MODES = ("lidar_passthrough", "lidar_passthrough_odom", "delayed_passthrough")
MODE = "lidar_passthrough_odom"
BUILDS = ("inflation_radius=0.7", "FollowPath.PathDist.scale=8")


def rows() -> Iterator[Row]:
    """Yield the figures."""
    campaign = read_reference([Path(os.environ.get("ORACLE_HOME") or "data")], build_manager())
    for mode in SPLIT_MODES:
        alarms = false_alarms(campaign, mode)
        rate = clopper_pearson(alarms / SPLITS, SPLITS)
        yield Row(f"{mode}: {SPLITS} splits that differ", 100.0 * rate.value, "%", 5,
                  remark=f"(95 %: {100 * rate.low:.2g} to {100 * rate.high:.2g} %)")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        usual = recorded(Path(folder) / "usual", "")
        for number, changed in enumerate(BUILDS):
            other = recorded(Path(folder) / str(number), changed)
            found = compare(usual, other)
            lowest = min((each.p_value for each in found.differences), default=1.0)
            yield Row(f"features that differ with {changed}", len(found.differences), "",
                      1, False, f"(smallest p-value {lowest:.2g})")  # fmt: skip


def false_alarms(campaign: Reference, mode: str) -> int:
    """Return how many random splits of the runs of a mode are reported as different."""
    table = campaign.table[campaign.table["mode"] == mode].reset_index(drop=True)
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(SPLITS):
        drawn = rng.permutation(len(table))[: 2 * EACH]
        first, second = (
            replace(campaign, table=table.iloc[rows].reset_index(drop=True))
            for rows in (drawn[:EACH], drawn[EACH:])
        )
        found += compare(first, second).outcome == "different"
    return found


def recorded(root: Path, changed: str) -> Reference:
    """Record the runs of one build and read them."""
    options = Options(wiring="absent", nav2_params=named_values([changed] if changed else []))
    campaign = Campaign(goals_per_run=1, options=options)
    for run in range(EACH):
        record_run(recipe_for(MODE, run, campaign), RunDirectory(root, MODE, run))
    return read_reference([root], build_manager())
