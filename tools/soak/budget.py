"""A campaign of hundreds of runs under a small storage budget, with disk usage sampled.

``python -m tools.soak.budget`` runs `dagster asset materialize` with ORACLE_STORAGE_BUDGET set, as
a person would. The campaign must end with all features, all graphs and a report, and the files
below ORACLE_HOME must never exceed the budget.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

from oracle_pipeline.bags.layout import TABLES, report_page
from oracle_pipeline.bags.run_directory import find_runs
from resources.storage.stock import parse_budget, take_stock

FIRST, LAST = "lidar_passthrough", "delayed_fakeobject"  # the six modes
MODES = 6
_PERIOD_S = 1.0
_SETTINGS = Path(__file__).parents[2] / ".dagster_home" / "dagster.yaml"


class Watch(threading.Thread):
    """Samples the disk usage below a root and the memory of the processes of a group."""

    def __init__(self, root: Path, group: int) -> None:
        super().__init__()
        self._root, self._group = root, group
        self._over = threading.Event()
        self.most_bytes = 0
        self.most_memory = 0  # largest of any process [B]
        self.samples = 0

    def run(self) -> None:
        """Take samples until it is stopped."""
        while not self._over.wait(_PERIOD_S):
            self.most_bytes = max(self.most_bytes, take_stock(self._root).total)
            self.most_memory = max(self.most_memory, _largest_process(self._group))
            self.samples += 1

    def stop(self) -> None:
        """Stop taking samples."""
        self._over.set()
        self.join()


def _largest_process(group: int) -> int:
    page, largest = os.sysconf("SC_PAGESIZE"), 0
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        if int(fields[2]) == group:
            largest = max(largest, page * int(fields[21]))
    return largest


def campaign(
    home: Path, runs: int, goals: int, *, budget: str = "", stdout: int | None = None
) -> "subprocess.Popen[bytes]":
    """Start the whole asset graph over the six modes; the default budget is the free disk space."""
    environment = os.environ | {
        "DAGSTER_HOME": str(home / "dagster"),
        "ORACLE_HOME": str(home / "data"),
        "ORACLE_RUNS": str(runs),
        "ORACLE_GOALS_PER_RUN": str(goals),
        "ORACLE_STORAGE_BUDGET": budget,
    }
    for folder in ("dagster", "data"):
        (home / folder).mkdir(parents=True, exist_ok=True)
    shutil.copy(_SETTINGS, home / "dagster")
    command = [
        sys.executable, "-m", "dagster", "asset", "materialize",
        "-m", "oracle_pipeline.definitions", "--select", "*",
        "--partition-range", f"{FIRST}|run000...{LAST}|run{runs - 1:03d}",
    ]  # fmt: skip
    return subprocess.Popen(  # in another folder, as the `.env` of a checkout takes precedence
        command, cwd=home, env=environment, start_new_session=True, stdout=stdout, stderr=stdout
    )


def main() -> None:
    """Run the campaign and print the faults."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak.budget", description=main.__doc__)
    parser.add_argument("--runs", type=int, default=100, help="of each of the six modes")
    parser.add_argument("--goals", type=int, default=1)
    parser.add_argument("--budget", default="2GB")
    parser.add_argument("--home", type=Path, help="folder to keep; by default a temporary one")
    arguments = parser.parse_args()
    limit = parse_budget(arguments.budget)
    assert limit is not None  # noqa: S101 -- it has a default
    with tempfile.TemporaryDirectory() as folder:
        home = arguments.home or Path(folder)
        started = time.monotonic()
        running = campaign(home, arguments.runs, arguments.goals, budget=arguments.budget)
        watch = Watch(home / "data", running.pid)
        watch.start()
        failed = running.wait()
        watch.stop()
        wrong = ["the campaign failed"] if failed else []
        wrong += _missing_parts(home / "data", MODES * arguments.runs)
        if watch.most_bytes > limit:
            wrong.append(f"{watch.most_bytes} bytes were more than the budget of {limit}")
        runs = find_runs(home / "data")
        kept = Counter(run.manifest().measured.kept for run in runs)
        print(
            f"{len(runs)} runs in {time.monotonic() - started:.0f} s, kept {dict(kept)}; at most "
            f"{watch.most_bytes / 1e6:.0f} of {limit / 1e6:.0f} MB in {watch.samples} samples, "
            f"largest process {watch.most_memory / 2**20:.0f} MiB"
        )
    print("\n".join(wrong) or "Everything exists, and the budget was kept.")
    sys.exit(bool(wrong))


def _missing_parts(root: Path, expected: int) -> list[str]:
    runs = find_runs(root)
    wrong = [] if len(runs) == expected else [f"{len(runs)} of {expected} runs exist"]
    for run in runs:
        intervals = sum(file.stem.isdecimal() for file in run.graphs.glob("*.gexf"))
        if intervals != int((run.manifest().recording_s + 5.0) // 10.0):
            wrong.append(f"{run.key} lacks graphs")
        wrong += [f"{run.key} lacks {t}" for t in TABLES if not run.feature_table(t).is_file()]
    if not report_page(root).is_file():
        wrong.append("there is no report")
    return wrong


if __name__ == "__main__":
    main()
