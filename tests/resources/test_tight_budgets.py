"""A campaign under a storage budget runs to its end, whatever its runs turn out to need."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from oracle_pipeline.bags.manifest import Kept
from oracle_pipeline.bags.run_directory import RunDirectory
from resources.storage.plan import StorageError
from resources.storage.stock import StoragePlan, make_plan, take_stock
from sim.pairs import CONTROL
from tests.manifests import rewrite
from tests.recorded_runs import RecordedRuns

pytestmark = pytest.mark.slow

MB = 1_000_000
WORKERS, BLOCKS = 2, 3
# Bags of the campaign of the README [MB], by mode and block. One robot is stuck until its time is
# over, so that its recording is three times as long as the others.
BAGS = {
    "lidar_passthrough": (15.8, 18.8, 15.8),
    "random_noise": (17.8, 20.5, 17.8),
    "lidar_passthrough_odom": (15.8, 18.8, 15.8),
    "fake_object": (16.5, 20.8, 16.5),
    "delayed_passthrough": (15.7, 18.8, 15.7),
    "delayed_fakeobject": (16.3, 58.5, 16.3),
}
STUCK = "delayed_fakeobject|run001"
GRAPHS = 0.14  # graphs and features, as a share of the bag
TRIMMED = 0.45


def sized(run: RunDirectory, kept: Kept) -> None:
    """Give a run the sizes that it has if so much of it is kept."""
    full = BAGS[run.mode][run.run % BLOCKS] * MB
    bag = round({"full": full, "trimmed": TRIMMED * full, "recipe": 0.0}[kept])
    for part, size in (("bag/bag_0.mcap", bag), ("graphs/run.gexf", round(GRAPHS * full))):
        place = run.path / part
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
        os.truncate(place, size)
    rewrite(
        run,
        lambda document: document["measured"].update(
            kept=kept, freed_bytes=round(full) - bag, bytes={"bag": bag, "graphs": 0}
        ),
    )


def in_pairs(runs: list[RunDirectory]) -> Iterator[list[RunDirectory]]:
    """Yield as many runs as are recorded at the same time."""
    yield from (runs[first : first + WORKERS] for first in range(0, len(runs), WORKERS))


@pytest.mark.parametrize("budget", [120, 160, 200, 250, 300, 400])
def test_every_run_is_recorded_within_the_budget(
    recorded_run: RecordedRuns, tmp_path: Path, budget: int
) -> None:
    manifest = recorded_run(CONTROL, 0).manifest_path
    waiting = [RunDirectory(tmp_path, mode, block) for block in range(BLOCKS) for mode in BAGS]
    while waiting:
        plan = make_plan(tmp_path, waiting, budget=budget * MB, reserve=0, workers=WORKERS, goals=8)
        for run in plan.shrink:
            sized(run, plan.kept[run.run])
        blocks = sorted({run.run for run in waiting})[: plan.blocks_ahead]
        batch = [run for run in waiting if run.run in blocks]
        waiting = waiting[len(batch) :]
        for pair in in_pairs(batch):
            for run in pair:
                run.path.mkdir(parents=True)
                shutil.copy(manifest, run.path)
                sized(run, "full")
            trimmed = [run for run in pair if plan.kept[run.run] == "trimmed"]
            copies = sum(TRIMMED * BAGS[run.mode][run.run] * MB for run in trimmed)
            if STUCK not in [run.key for run in pair]:  # which no plan can foresee
                assert take_stock(tmp_path).total + copies <= budget * MB
            for run in pair:
                sized(run, plan.kept[run.run])
            assert take_stock(tmp_path).total <= budget * MB
    assert len(take_stock(tmp_path).runs) == BLOCKS * len(BAGS)


def test_tables_that_will_be_joined_need_little_storage(
    recorded_run: RecordedRuns, tmp_path: Path
) -> None:
    runs = [RunDirectory(tmp_path, CONTROL, block) for block in range(100)]
    for run in runs[:4]:
        run.path.mkdir(parents=True)
        shutil.copy(recorded_run(CONTROL, 0).manifest_path, run.path)
        sized(run, "recipe")
        table = run.feature_table("window")
        table.parent.mkdir(parents=True, exist_ok=True)
        table.touch()
        os.truncate(table, 9 * MB)

    def plan(together: int) -> StoragePlan:
        return make_plan(
            tmp_path, runs, budget=600 * MB, reserve=0, workers=1, goals=8, together=together
        )

    assert set(plan(together=20).kept) == set(range(100))
    with pytest.raises(StorageError, match="graphs and features alone take 1"):
        plan(together=1)
    with pytest.raises(StorageError, match="do not fit"):  # none is joined before the last
        plan(together=100)
