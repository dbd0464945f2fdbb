"""The shell command that records further runs."""

import os
import shlex
from collections.abc import Sequence

from assets.partitions import ALL, chosen_modes, run_count, testbed_of
from sim.modes import modes

# Settings that affect which runs are recorded and where; the command includes those that are set.
REPEATED = (
    "ORACLE_HOME", "ORACLE_GOALS_PER_RUN", "ORACLE_ARENA", "ORACLE_NAV2", "ORACLE_SESSIONS",
    "ORACLE_NOISE_PER_RUN", "ORACLE_SCENARIOS", "ORACLE_TESTBEDS", "ORACLE_ALLOW_ACTUATION",
)  # fmt: skip


def record_command(wanted: Sequence[str], blocks: int, testbed: str) -> str:
    """Return the command that records the first blocks of modes, and analyses them.

    A range of partitions covers neighbouring modes. Runs that exist are verified.

    Parameters
    ----------
    wanted : sequence of str
        Modes.
    blocks : int
        Number of blocks, from the first one.
    testbed : str
        That of the campaign: modes of others would be of no use. Without any left, all of its
        modes are recorded.
    """
    known = [mode for mode in modes() if testbed_of(mode) == testbed]
    chosen = [mode for mode in known if mode in wanted] or known
    settings = {name: os.environ[name] for name in REPEATED if os.environ.get(name)}
    if blocks > run_count(os.environ) or os.environ.get("ORACLE_RUNS"):
        settings["ORACLE_RUNS"] = str(max(blocks, run_count(os.environ)))
    if not set(chosen) <= set(chosen_modes(os.environ)):
        settings["ORACLE_MODES"] = ALL
    words = [f"{name}={shlex.quote(value)}" for name, value in settings.items()]
    keys = f"{chosen[0]}|run000...{chosen[-1]}|run{blocks - 1:03d}"
    return " ".join(
        [*words, "dagster asset materialize -m oracle_pipeline.definitions --select '*'",
         f"--partition-range '{keys}'"]
    )  # fmt: skip
