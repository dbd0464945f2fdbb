"""What may be spent on disk, as a Dagster resource. ``resources.storage`` does the planning."""

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
    """A plan before runs are made: a full disk is met at the start and not in the middle."""

    limit: str = Field(
        default="",
        description="What everything below the root may take: bytes, or such as `20GiB`; empty: "
        "what is free, less the reserve.",
    )
    reserve_mb: int = Field(
        default=500, ge=0, description="Space on the disk of the root that has to stay free [MB]."
    )

    def plan(
        self, store: RunStore, wanted: Sequence[RunDirectory], *, workers: int, goals: int
    ) -> StoragePlan | None:
        """Plan what is kept of which runs; None in an object store, which has no end.

        Raises
        ------
        dagster.Failure
            If not even graphs and features fit; it says what would.
        """
        with clear_failures():
            budget = parse_budget(self.limit)
            if not store.is_local:
                return None
            return make_plan(
                store.path,
                wanted,
                budget=budget,
                reserve=self.reserve_mb * 1_000_000,
                workers=workers,
                goals=goals,
            )

    @contextlib.contextmanager
    def alone(self, store: RunStore) -> Iterator[None]:
        """Spend what is planned: whoever else makes runs below this root waits, or is waited for.

        A plan holds only as long as nobody else fills the disk after another one.
        """
        if not store.is_local:
            yield
            return
        with contextlib.ExitStack() as held:
            try:
                held.enter_context(lock(store.path, wait=False))
            except BlockingIOError:
                dg.get_dagster_logger("oracle").info(
                    f"Another materialization makes runs below {store.path}; this one goes on when "
                    "that has ended."
                )
                held.enter_context(lock(store.path))
            yield
