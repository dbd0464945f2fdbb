"""A root for runs with a separate Dagster instance, and the campaign that the tests share."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import dagster as dg

from oracle_pipeline.definitions import build_defs
from resources.campaign import CampaignSettings
from resources.fleet import Fleet
from resources.store import RunStore
from tests.instances import instance_of, make_home

CONTROL, ATTACKED = "lidar_passthrough", "random_noise"  # a pair of modes with short runs
KEYS = [f"{mode}|run00{run}" for mode in (CONTROL, ATTACKED) for run in (0, 1)]
KEY, PARTNER = f"{ATTACKED}|run000", f"{CONTROL}|run000"
PER_RUN = ["experiment_runs", "bags", "interval_graphs", "window_features", "run_features"]
EVERYTHING = [
    *PER_RUN,
    "feature_dataset",
    "bootstrapped_dataset",
    "clustering_grid_search",
    "malicious_rate_report",
    "pairwise_report",
    "oracle_evaluation",
    "oracle_report",
]


ROOT = Path(__file__).parent.parent.parent


@contextmanager
def dagster_home(home: Path) -> Iterator[dg.DagsterInstance]:
    """An instance as `.dagster_home` configures it, in a separate folder: the one in use."""
    with (
        mock.patch.dict(os.environ, DAGSTER_HOME=str(home)),
        instance_of(with_databases(home)) as instance,
    ):
        yield instance


def with_databases(home: Path) -> Path:
    """Make a folder the home of an instance, unless it is one.

    Its databases are copies: Dagster takes four times as long to make them.
    """
    if not home.exists():
        shutil.copytree(_empty_home().name, home)
    return home


@cache
def _empty_home() -> "TemporaryDirectory[str]":
    folder = TemporaryDirectory(prefix="dagster-home-")
    with instance_of(make_home(Path(folder.name))):
        return folder


@dataclass
class Laboratory:
    """A root for runs and a separate Dagster instance, as a user has them."""

    root: Path
    instance: dg.DagsterInstance

    @property
    def store(self) -> RunStore:
        return RunStore(root=str(self.root))

    def defs(self, **overrides: Any) -> dg.Definitions:
        resources = {
            "store": self.store,
            "fleet": Fleet(workers=2),
            "campaign": CampaignSettings(goals_per_run=1),
        }
        return build_defs(**(resources | overrides))

    def materialize(
        self,
        assets: list[str],
        first: str | None = None,
        last: str | None = None,
        *,
        config: dict[str, Any] | None = None,
        **overrides: Any,
    ) -> dg.ExecuteInProcessResult:
        """Do what `dagster asset materialize --select ...` does, with one partition or a range."""
        job = self.defs(**overrides).resolve_implicit_global_asset_job_def()
        between = {
            "dagster/asset_partition_range_start": str(first),
            "dagster/asset_partition_range_end": str(last),
        }
        return job.execute_in_process(
            asset_selection=[dg.AssetKey(asset) for asset in assets],
            instance=self.instance,
            partition_key=None if last else first,
            tags=between if last else None,
            run_config={"ops": {name: {"config": of} for name, of in (config or {}).items()}},
            raise_on_error=False,
        )

    def materialized(self, asset: str) -> set[str]:
        return set(self.instance.get_materialized_partitions(dg.AssetKey(asset)))

    def latest(self, asset: str, key: str | None = None) -> dg.AssetMaterialization:
        records = self.instance.fetch_materializations(
            dg.AssetRecordsFilter(
                asset_key=dg.AssetKey(asset), asset_partitions=[key] if key else None
            ),
            limit=1,
        ).records
        found = records[0].asset_materialization
        assert found is not None
        return found

    def figures(self, asset: str, key: str | None = None) -> dict[str, Any]:
        return {name: value.value for name, value in self.latest(asset, key).metadata.items()}

    def files(self) -> dict[str, tuple[int, int]]:
        """Every file below the root with its time stamp and size."""
        return {
            str(path.relative_to(self.root)): (path.stat().st_mtime_ns, path.stat().st_size)
            for path in sorted(self.root.rglob("*"))
            if path.is_file()
        }
