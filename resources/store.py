"""Where runs, features, datasets and reports live: the layout of one folder."""

import tempfile
from pathlib import Path

import dagster as dg
from pydantic import Field

from oracle_pipeline.bags.run_directory import RunDirectory, find_runs


class RunStore(dg.ConfigurableResource[None]):
    """The folder below which everything is kept."""

    root: str = Field(
        default="data",
        description="Folder for runs, features, datasets and the report; made if it is not there.",
    )

    @property
    def path(self) -> Path:
        """The root, absolute."""
        return Path(self.root).expanduser().resolve()

    def require_writable(self) -> None:
        """Make the root; fail now, with advice, if nothing could be written there later."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path):
                pass
        except OSError as error:
            raise dg.Failure(
                f"Nothing can be written below {self.path}: {error.strerror}. "
                "Point ORACLE_HOME to a folder that can be written to.",
                allow_retries=False,
            ) from error

    def run(self, key: str) -> RunDirectory:
        """Return the place of a run, by its partition key."""
        mode, run_id = key.split("|")
        return RunDirectory(self.path, mode, int(run_id.removeprefix("run")))

    def complete_runs(self) -> list[RunDirectory]:
        """Return the runs that are there, sorted by mode and number."""
        return find_runs(self.path)

    def dataset(self, name: str) -> Path:
        """Return the place of a table over many runs."""
        return self.path / "datasets" / f"{name}.parquet"

    def results(self, name: str) -> Path:
        """Return the folder of one report's table, pictures and facts."""
        return self.path / "report" / "parts" / name

    @property
    def report(self) -> Path:
        """The report: one HTML file."""
        return self.path / "report" / "index.html"
