"""Compile the hot loops, so that the first run does not wait for it, nor each worker do it again.

numba keeps machine code beside the sources, for each function and each type of its arguments. What
types there are, only calls show: so this does what a campaign does, once and small, with a process
for each part. The features are those of a short recording that comes with the project.
"""

import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.clustering.scaling import FlooredRobustScaler
from oracle_pipeline.datasets import feature_columns
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.opened_run import open_run
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run

MODE = "fake_object"
SHORT = Path(__file__).parents[2] / "examples" / "demo" / "short"


def main() -> None:
    """Record a short run and extract features, both at once."""
    print("Compiling simulator and features (about half a minute, once) ...", flush=True)
    with ProcessPoolExecutor() as pool:
        for done in [pool.submit(part) for part in (simulate, measure)]:
            done.result()


def simulate() -> None:
    """Record a run of one goal."""
    with tempfile.TemporaryDirectory(prefix="oracle-") as root:
        run = RunDirectory(Path(root), MODE, 0)
        record_run(recipe_for(MODE, run.run, Campaign(goals_per_run=1)), run)


def measure() -> None:
    """Extract the features of the short recording, and scale them."""
    with open_run(SHORT) as run:
        features = extract(run, build_manager(None)).run
    FlooredRobustScaler().fit_transform(features[feature_columns(features)])


if __name__ == "__main__":
    main()
