"""The folder of runs, features, datasets and reports, on the local disk or on S3."""

import secrets
from pathlib import Path

import dagster as dg
from pydantic import Field

from oracle_pipeline.bags import layout
from oracle_pipeline.bags.protocol import runs_named
from oracle_pipeline.bags.remote import place_at
from oracle_pipeline.bags.run_directory import RunDirectory


class RunStore(dg.ConfigurableResource[None]):
    """The root folder of all content."""

    # Not part of the run config: a run request must not choose where this process writes.
    root: dg.ResourceDependency[str] = Field(
        default="data",  # type: ignore[arg-type]  # Dagster makes a dependency of it
        description="Folder for runs, features, datasets and the report, created if necessary; or "
        "a folder in an object store, such as `s3://bucket/prefix`.",
    )

    @property
    def is_local(self) -> bool:
        """Whether the root is on a local or mounted disk."""
        return "://" not in self.root

    @property
    def path(self) -> Path:
        """The absolute root; for an object store a ``UPath``, which acts like a ``Path``."""
        return place_at(self.root)

    def require_writable(self) -> None:
        """Create the root, and raise an error with advice if it is not writable."""
        try:
            if self.is_local:
                self.path.mkdir(parents=True, exist_ok=True)
            probe = self.path / f".{secrets.token_hex(4)}"
            probe.write_bytes(b"")
            probe.unlink()
        except ImportError as error:
            raise dg.Failure(
                f"{self.root} needs a library that is not installed: {error}. Install it with "
                "pip install 'ros2-behaviour-oracle[s3]', here and on the workers.",
                allow_retries=False,
            ) from error
        except Exception as error:  # clients of object stores raise various exceptions
            place, advice = (
                (self.path, "a writable folder")
                if self.is_local
                else (self.root, "a writable bucket, and check keys and endpoint")
            )
            raise dg.Failure(
                f"Nothing can be written below {place}: {error}. Point ORACLE_HOME to {advice}.",
                allow_retries=False,
            ) from error

    def run(self, key: str) -> RunDirectory:
        """Return the directory of a run, by its key ``<mode>|run003``."""
        return RunDirectory.of_key(self.path, key)

    def runs(self, partition: str) -> list[RunDirectory]:
        """Return the directories of the runs of a partition, by its key."""
        mode, name = partition.split("|")
        return [RunDirectory(self.path, mode, run) for run in runs_named(name) or ()]

    def dataset(self, name: str) -> Path:
        """Return the path of a table over many runs."""
        return layout.dataset(self.path, name)

    def results(self, name: str) -> Path:
        """Return the folder of one report's table, pictures and facts."""
        return layout.report_part(self.path, name)

    def grid_indices(self) -> list[Path]:
        """Return the path of the index of each grid below the root."""
        return layout.grid_indices(self.path)

    @property
    def report(self) -> Path:
        """The report's main page."""
        return layout.report_page(self.path)

    @property
    def run_pages(self) -> Path:
        """The folder with the report's pages of single runs."""
        return layout.report_run_pages(self.path)
