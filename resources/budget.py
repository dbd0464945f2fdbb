"""The storage budget as a Dagster resource. ``resources.storage`` does the planning."""

import contextlib
from collections.abc import Iterator, Sequence

import dagster as dg
from pydantic import Field

from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.scratch import lock
from resources.failures import clear_failures
from resources.storage.stock import StoragePlan, make_plan, parse_budget
from resources.store import RunStore


class StorageBudget(dg.ConfigurableResource[None]):
    """Plans storage before runs start, so that a lack of disk space is reported at once."""

    limit: str = Field(
        default="",
        description="Limit for everything below the root: bytes, or for example `20GiB`. Empty: "
        "the free space less the reserve.",
    )
    reserve_mb: int = Field(
        default=500, ge=0, description="Space that stays free on the disk of the root [MB]."
    )

    def plan(
        self, store: RunStore, wanted: Sequence[RunDirectory], *, workers: int, goals: int,
        together: int,
    ) -> StoragePlan | None:  # fmt: skip
        """Plan how much of each run is kept; None in an object store, which has no limit.

        Raises
        ------
        dagster.Failure
            If graphs and features alone do not fit; it states the number of blocks that would.
        """
        with clear_failures():
            budget = parse_budget(self.limit)
            if not store.is_local:
                return None
            return make_plan(
                store.path, wanted, budget=budget, reserve=self.reserve_mb * 1_000_000,
                workers=workers, goals=goals, together=together,
            )  # fmt: skip

    @contextlib.contextmanager
    def alone(self, store: RunStore) -> Iterator[None]:
        """Lock the root, so that only one materialization writes runs below it at a time.

        A plan is valid only while no other process fills the disk. A second materialization waits.
        """
        if not store.is_local:
            yield
            return
        with contextlib.ExitStack() as held:
            try:
                held.enter_context(lock(store.path, wait=False))
            except BlockingIOError:
                dg.get_dagster_logger("oracle").info(
                    f"Another materialization writes runs below {store.path}; waiting until it has "
                    "ended."
                )
                held.enter_context(lock(store.path))
            yield
