"""The layout of a root: where runs, features, datasets, reports and grids are kept below it.

Functions of a root and names to a path, whether it exists or not; nothing is read or written. The
root is a folder of this machine or, as a ``UPath``, one in an object store.
"""

from pathlib import Path
from typing import Literal, NamedTuple

TableName = Literal["run", "window"]
TABLES: tuple[TableName, ...] = ("run", "window")

RUNS, FEATURES, DATASETS, REPORT, GRIDS = "runs", "features", "datasets", "report", "grids"
FOREIGN = "foreign"  # results for recordings from elsewhere
SEARCHES = "searches"  # for attacks that the oracle misses
FINDINGS, FRONT = "findings.json", "front.png"  # of a search
VERDICT = "verdict.json"
GRID_INDEX = "grid.json"  # of a grid: what was changed in each of its runs
REFRESHED = "refreshed"  # a root of runs that differ unexpectedly when simulated again


def run_folder(root: Path, mode: str, run_id: str) -> Path:
    """Return ``<root>/runs/<mode>/<run_id>``."""
    return root / RUNS / mode / run_id


def feature_table(root: Path, table: TableName, mode: str, run_id: str) -> Path:
    """Return ``<root>/features/<table>/<mode>/<run_id>.parquet``."""
    return root / FEATURES / table / mode / f"{run_id}.parquet"


def feature_tables(root: Path, table: TableName) -> list[Path]:
    """Return the feature tables of all runs that are below a root, sorted by mode and run."""
    return sorted(root.glob(f"{FEATURES}/{table}/*/*.parquet"))


def dataset(root: Path, name: str) -> Path:
    """Return ``<root>/datasets/<name>.parquet``, a table over many runs."""
    return root / DATASETS / f"{name}.parquet"


def report_part(root: Path, name: str) -> Path:
    """Return ``<root>/report/parts/<name>``, the folder of one report's tables and pictures."""
    return root / REPORT / "parts" / name


def report_page(root: Path) -> Path:
    """Return ``<root>/report/index.html``, the report for people."""
    return root / REPORT / "index.html"


def foreign(root: Path, key: str) -> Path:
    """Return ``<root>/foreign/<key>``, the folder for the features and the verdict of a recording.

    The recording itself stays where it arrived.
    """
    return root / FOREIGN / key


def foreign_verdicts(root: Path) -> list[Path]:
    """Return the verdicts on all foreign recordings below a root, sorted by key."""
    return sorted((root / FOREIGN).glob(f"*/{VERDICT}"))


def foreign_rows(root: Path) -> Path:
    """Return ``<root>/report/foreign.parquet``, a row for each foreign recording."""
    return root / REPORT / "foreign.parquet"


def foreign_page(root: Path) -> Path:
    """Return ``<root>/report/foreign.html``, the report on foreign recordings."""
    return root / REPORT / "foreign.html"


def searches(root: Path) -> list[Path]:
    """Return the folders ``<root>/searches/<name>`` of all searches, sorted by name."""
    return sorted(path.parent for path in (root / SEARCHES).glob(f"*/{FINDINGS}"))


def report_run_pages(root: Path) -> Path:
    """Return ``<root>/report/runs``, the folder with a page for each run."""
    return root / REPORT / RUNS


def grid_root(root: Path, name: str) -> Path:
    """Return ``<root>/grids/<name>``, itself a root with the runs of one grid."""
    return root / GRIDS / name


def grid_indices(root: Path) -> list[Path]:
    """Return the index files of all grids below a root, sorted by name."""
    return sorted((root / GRIDS).glob(f"*/{GRID_INDEX}"))


class Owner(NamedTuple):
    """The run that a file belongs to."""

    mode: str
    run_id: str
    part: str  # of the run: a folder or file of its directory, or "features"


def owner(parts: tuple[str, ...]) -> Owner | None:
    """Return the run that a file belongs to, by its path below the root; None if to no run.

    Examples
    --------
    >>> owner(("runs", "fake_object", "run003", "bag", "bag_0.mcap"))
    Owner(mode='fake_object', run_id='run003', part='bag')
    >>> owner(("features", "run", "fake_object", "run003.parquet"))
    Owner(mode='fake_object', run_id='run003', part='features')
    >>> owner(("report", "index.html"))
    """
    if parts[0] == RUNS and len(parts) > 3:
        return Owner(parts[1], parts[2], parts[3])
    if parts[0] == FEATURES and len(parts) == 4:
        return Owner(parts[2], parts[3].partition(".")[0], FEATURES)
    return None
