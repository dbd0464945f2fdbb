"""Record the short run whose features set-up extracts, so that their loops are compiled.

It is made anew if a plug-in reads a type of message that it lacks.
"""

import shutil
import tempfile
from pathlib import Path

from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run
from tools.scripts.compile_loops import MODE, SHORT

LENGTH_S = 6.0  # long enough for all windows


def main() -> None:
    """Replace the recording."""
    with tempfile.TemporaryDirectory(prefix="oracle-") as root:
        run = RunDirectory(Path(root), MODE, 0)
        record_run(recipe_for(MODE, 0, Campaign(goals_per_run=1, timeout_s=LENGTH_S)), run)
        shutil.rmtree(SHORT, ignore_errors=True)
        shutil.copytree(run.path, SHORT)


if __name__ == "__main__":
    main()
