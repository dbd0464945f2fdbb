"""The one partitions definition: every run of every experiment mode.

A key reads ``fake_object|run003``. Run numbers are static, so that a new one appears in every mode
at once. Their count and the scenario files of the user's folder are read when the code location
loads. A broken scenario file is named in the log and left out.
"""

import os
from collections.abc import Mapping

import dagster as dg

from oracle_pipeline.bags.errors import OracleError
from sim.modes import broken_scenarios, modes


class ConfigurationError(OracleError):
    """An environment variable has an invalid value."""


def run_count(environment: Mapping[str, str]) -> int:
    """Return how many runs each mode has: ``ORACLE_RUNS``, or the thesis's 15.

    Raises
    ------
    ConfigurationError
        If it is not a whole number of 1 or more.
    """
    text = environment.get("ORACLE_RUNS") or "15"
    if not text.isdecimal() or int(text) < 1:
        raise ConfigurationError(
            f"ORACLE_RUNS is {text!r}; give the number of runs of each mode, 1 or more."
        )
    return int(text)


def runs_of_modes(count: int) -> dg.MultiPartitionsDefinition:
    """Return ``count`` runs of every mode, modes in their own order."""
    return dg.MultiPartitionsDefinition(
        {
            "mode": dg.StaticPartitionsDefinition(list(modes())),
            "run": dg.StaticPartitionsDefinition([f"run{run:03d}" for run in range(count)]),
        }
    )


RUNS = runs_of_modes(run_count(os.environ))
for broken in broken_scenarios():
    dg.get_dagster_logger().warning(f"Left out: {broken}")
