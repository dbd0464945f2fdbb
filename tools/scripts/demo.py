"""`make demo`: a normal and an attacked run, recorded now and judged by the shipped reference card.

Both runs have the same start, goal and sensor noise; the second LiDAR of the attacked one reports
an object that does not exist. Neither is among the runs that the card was learned from. In a fresh
clone, the loops of the simulator are compiled as it runs, and beside it those of the features.
"""

import os
import sys
import webbrowser
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from pathlib import Path

import oracle_pipeline
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from sim.commands.batch import home
from sim.experiments import recipe_for, record_run
from tools.scripts.compile_loops import measure

PROJECT = Path(__file__).parents[2]
CARD = PROJECT / "examples" / "demo" / "normal.card"
NORMAL, ATTACKED = "lidar_passthrough_odom", "fake_object"
BLOCK = 900  # the card is learned from the first blocks
GOALS = 1
STALE = (
    f"The shipped card {CARD.relative_to(PROJECT)} no longer fits the code: the {NORMAL} run "
    f"should be normal, the {ATTACKED} run anomalous. Learn it again with `make demo-card`."
)


def main() -> int:
    """Record, judge and show the two runs; return 1 if the card no longer fits the code."""
    place = home() / "demo"
    print("In a fresh clone, this compiles first (about half a minute, once).", flush=True)
    with ProcessPoolExecutor(1) as beside:
        ready = beside.submit(make_ready)
        runs = [recorded(mode, place) for mode in (NORMAL, ATTACKED)]
        ready.result()
    print(f"Comparing them with the normal runs of {CARD.relative_to(PROJECT)} ...", flush=True)
    verdicts, page = oracle_pipeline.score(runs, CARD), (place / "index.html").resolve()
    verdicts.write_page(page)
    print(f"{verdicts}\nPage: {page.as_uri()}")
    if [verdict.outcome for verdict in verdicts] != ["normal", "anomalous"]:
        print(STALE, file=sys.stderr)
        return 1
    if sys.stdout.isatty() and (os.environ.get("DISPLAY") or sys.platform == "darwin"):
        webbrowser.open(page.as_uri())
    return 0


def make_ready() -> None:
    """Compile the loops of features, and the modules that judge to bytecode."""
    measure()
    import_module("oracle_pipeline.api")


def recorded(mode: str, place: Path) -> Path:
    """Record the demo's run of one mode, with the code as it is now."""
    directory = RunDirectory(place, mode, BLOCK)
    print(f"Recording {directory.key} ...", flush=True)
    recipe = recipe_for(mode, BLOCK, Campaign(goals_per_run=GOALS))
    record_run(recipe, directory, refresh=True)
    return directory.path


if __name__ == "__main__":
    sys.exit(main())
