"""The runs of one partition: those that are over, and what they are together.

A partition of one run is described by that run. One of several has totals, and names the runs that
failed; their features are joined in one file.
"""

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from oracle_pipeline.bags.run_directory import RunDirectory

if TYPE_CHECKING:
    from assets.worker.reproduction import Reproduction
    from assets.worker.run_job import AssetOfRun, Figures, RunReport

# Figures of runs that add up; of the others, only those that all runs share are shown.
_TOTALS = {
    *("bytes", "contacts", "edges", "freed_bytes", "goals", "goals_reached", "intervals"),
    *("messages", "missing", "recording_s", "wall_s", "dagster/row_count"),
}


@dataclass(slots=True)
class PartitionWork:
    """The runs of a partition while they are processed.

    Attributes
    ----------
    key
        Of the partition: ``fake_object|run003``, or ``fake_object|run000-249``.
    runs
        All of its runs.
    reports
        Of the runs that are over and have not failed.
    failed
        The runs that have.
    """

    key: str
    runs: Sequence[RunDirectory]
    reports: "dict[RunDirectory, RunReport]" = field(default_factory=dict)
    failed: list[RunDirectory] = field(default_factory=list)

    def add(self, run: RunDirectory, report: "RunReport | None") -> bool:
        """Add a run that is over, None if it failed; return whether all are over."""
        if report is None:
            self.failed.append(run)
        else:
            self.reports[run] = report
            if len(self.runs) > 1:  # hundreds of pictures would fill memory and event log
                for state in report.assets.values():
                    state.figures.pop("picture", None)
        return len(self.reports) + len(self.failed) == len(self.runs)

    @property
    def reproductions(self) -> "Mapping[RunDirectory, Reproduction]":
        """The comparisons of runs that were simulated again with the runs before."""
        found = {run: report.reproduction for run, report in self.reports.items()}
        return {run: reproduction for run, reproduction in found.items() if reproduction}

    def assets(self) -> "Mapping[str, AssetOfRun]":
        """Return the state of each asset; tables of several runs are joined first."""
        reports = dict(sorted(self.reports.items()))
        if len(self.runs) == 1:
            return next(iter(reports.values())).assets
        places = self._joined(list(reports))
        return {
            asset: self._together([report.assets[asset] for report in reports.values()], place)
            for asset in next(iter(reports.values())).assets
            for place in [places.get(asset)]
        }

    def _joined(self, runs: Sequence[RunDirectory]) -> dict[str, str]:
        """Join the tables of the runs; return the place of each asset that is a table."""
        from assets.worker.kept_tables import join_tables
        from assets.worker.run_job import TABLES
        from oracle_pipeline.bags.layout import feature_table

        if self.reports[runs[0]].assets.keys().isdisjoint(TABLES):
            return {}
        name = self.key.partition("|")[2]
        join_tables(runs, name)
        root, mode = runs[0].root, runs[0].mode
        places = {asset: feature_table(root, table, mode, name) for asset, table in TABLES.items()}
        return {asset: place.relative_to(root).as_posix() for asset, place in places.items()}

    def _together(self, states: "Sequence[AssetOfRun]", place: str | None) -> "AssetOfRun":
        """Return the state of an asset of several runs, by default at the folder of its mode."""
        shared = {name for of in states for name in of.figures}
        statuses = Counter(str(of.figures["status"]) for of in states)
        figures: Figures = {
            "runs": len(states),
            "failed": ", ".join(run.run_id for run in sorted(self.failed)),
            "status": ", ".join(f"{count} {status}" for status, count in statuses.items()),
        }
        for name in sorted(shared - {"status", "content_hash"}):
            values = [of.figures[name] for of in states if name in of.figures]
            if name in _TOTALS:
                figures[name] = sum(value for value in values if isinstance(value, int | float))
            elif len(set(values)) == 1:
                figures[name] = values[0]
        versions = "".join(of.version for of in states)
        return replace(
            states[0],
            path=place or states[0].path.rpartition("/run")[0],
            code=", ".join(sorted({of.code for of in states})),
            version=hashlib.sha256(versions.encode()).hexdigest(),
            figures=figures,
        )
