"""Runs that tests read: each is recorded once, for all test files and all test processes."""

import fcntl
import hashlib
import json
import os
import shutil
from pathlib import Path

from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from sim.experiments import recipe_for, record_run
from sim.software import run_code
from sim.testbed import Mode
from sim.testbeds import TESTBEDS

ONE_GOAL = Campaign(goals_per_run=1)


class RecordedRuns:
    """Runs by their recipe and by the code that makes them, in a folder that processes share.

    Parameters
    ----------
    folder
        Where they are kept, each in a separate root.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._code = run_code(testbed.made_by for testbed in TESTBEDS.values())

    def __call__(
        self, mode: str | Mode, run: int = 0, campaign: Campaign = ONE_GOAL, **parameters: object
    ) -> RunDirectory:
        """Return a run, and record it if necessary. Treat it as read-only.

        Parameters
        ----------
        mode, run, campaign
            As for ``recipe_for``.
        **parameters
            Values of the scenario's parameters.
        """
        recipe = recipe_for(mode, run, campaign, parameters)
        known = json.dumps([recipe.to_dict(), self._code], sort_keys=True)
        root = self.folder / hashlib.sha256(known.encode()).hexdigest()
        directory = RunDirectory(root, mode if isinstance(mode, str) else mode.id, run)
        with Path(f"{root}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not directory.is_complete():
                record_run(recipe, directory)
        return directory


def linked(run: RunDirectory, root: Path) -> RunDirectory:
    """Return a run below another root, to be read beside others: its files are hard links."""
    there = RunDirectory(root, run.mode, run.run)
    shutil.copytree(run.path, there.path, copy_function=os.link)
    return there


def copied(run: RunDirectory, root: Path) -> RunDirectory:
    """Return a copy of a run below another root, to be changed."""
    there = RunDirectory(root, run.mode, run.run)
    shutil.copytree(run.path, there.path)
    return there
