"""What may be spent on disk: so far, all but a reserve that stays free."""

import shutil
import statistics
from pathlib import Path

import dagster as dg
from pydantic import Field

from resources.store import RunStore

FIRST_GUESS = 60_000_000  # bytes a run of 8 goals, while no run is there to be measured
SAMPLE = 20  # runs, of all modes, that the expected size is the median of


class StorageBudget(dg.ConfigurableResource[None]):
    """A check before work begins, so that a full disk is met at the start and not in the middle."""

    reserve_mb: int = Field(
        default=500, ge=0, description="Space on the disk of the root that has to stay free [MB]."
    )

    def require_room(self, store: RunStore, runs: int) -> None:
        """Fail now if so many new runs would eat into the reserve.

        What a run takes is the median of those that are there.
        """
        free = shutil.disk_usage(store.path).free
        there = store.complete_runs()
        sizes = [_bytes_on_disk(run.path) for run in there[:: len(there) // SAMPLE + 1]]
        run_bytes = int(statistics.median(sizes)) if sizes else FIRST_GUESS
        needed = runs * run_bytes + self.reserve_mb * 1_000_000
        if runs and needed > free:
            raise dg.Failure(
                f"{runs} runs of about {run_bytes / 1e6:.0f} MB and a reserve of "
                f"{self.reserve_mb} MB do not fit into the {free / 1e6:.0f} MB that are free for "
                f"{store.path}. Free some space, materialize fewer runs, or point ORACLE_HOME to "
                "another disk.",
                metadata={"free_bytes": free, "needed_bytes": needed},
                allow_retries=False,
            )


def _bytes_on_disk(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
