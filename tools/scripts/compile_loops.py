"""Compile the hot loops, so that the first run does not wait for it, nor each worker do it again.

numba keeps machine code beside the sources, for each function and each type of its arguments. What
types there are, only calls show: so this does what a campaign does, once and small. Python keeps
the bytecode of what this imports: all that a campaign does, Dagster's commands included.
"""

import importlib
import tempfile
from pathlib import Path

from assets.worker.feature_tables import require_tables
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run

MODE = "fake_object"
COMMANDS = ("oracle_pipeline.definitions", "dagster._cli", "dagster_webserver.cli")


def main() -> None:
    """Record a short run, extract its features, and import Dagster."""
    with tempfile.TemporaryDirectory(prefix="oracle-") as root:
        run = RunDirectory(Path(root), MODE, 0)
        progress("Compiling the simulator (about half a minute, once) ...")
        record_run(recipe_for(MODE, run.run, Campaign(goals_per_run=1)), run)
        progress("Compiling the features (about half a minute, once) ...")
        require_tables(run)
    for module in COMMANDS:
        importlib.import_module(module)


def progress(line: str) -> None:
    """Print what happens now."""
    print(line, flush=True)


if __name__ == "__main__":
    main()
