"""The one partitions definition: every run of every experiment mode.

A key looks like ``fake_object|run003``. In a large campaign a partition holds several runs, and its
key reads ``fake_object|run000-249``: Dagster's cost grows with partitions, ours with runs. Numbers
are static, so that a new one appears in every mode at once. Counts, the selected modes, and the
user's scenario files are read when the code location loads. An invalid scenario file is logged and
left out.

There is one definition for all testbeds, because Dagster rejects commands over assets with
different partitions, and ``--select '*'`` should mean the whole campaign.
"""

import os
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

import dagster as dg

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.protocol import runs_name
from sim.modes import left_out, modes
from sim.testbeds import TESTBEDS, which_testbed

ALL = "*"


class ConfigurationError(OracleError):
    """An environment variable has an invalid value."""


def run_count(environment: Mapping[str, str]) -> int:
    """Return the number of runs of each mode: ``ORACLE_RUNS``, or the thesis's 15.

    Raises
    ------
    ConfigurationError
        If it is not a positive integer.
    """
    return _positive(environment, "ORACLE_RUNS", 15, "the number of runs of each mode")


def runs_per_partition(environment: Mapping[str, str]) -> int:
    """Return the number of runs in a partition: ``ORACLE_RUNS_PER_PARTITION``, or 1.

    Raises
    ------
    ConfigurationError
        If it is not a positive integer.
    """
    return _positive(environment, "ORACLE_RUNS_PER_PARTITION", 1, "the runs of a partition")


def _positive(environment: Mapping[str, str], name: str, default: int, meaning: str) -> int:
    text = environment.get(name) or str(default)
    if not text.isdecimal() or int(text) < 1:
        raise ConfigurationError(f"{name} is {text!r}; give {meaning}, 1 or more.")
    return int(text)


def testbed_of(mode: str) -> str:
    """Return the name of the testbed that a mode runs on."""
    return which_testbed(modes()[mode].scenario)


def chosen_modes(environment: Mapping[str, str]) -> list[str]:
    """Return the modes that are partitions: ``ORACLE_MODES``, or all.

    The variable lists testbeds and modes, separated by commas; ``*`` is a wildcard.

    Raises
    ------
    ConfigurationError
        If a part of it matches no mode.
    """
    wanted = [part.strip() for part in (environment.get("ORACLE_MODES") or ALL).split(",")]
    named = {
        part: [mode for mode in modes() if fnmatchcase(mode, part) or testbed_of(mode) == part]
        for part in wanted
    }
    if empty := [part for part, found in named.items() if not found]:
        raise ConfigurationError(
            f"ORACLE_MODES: {empty[0]!r} matches no mode; give modes, with * as wildcard, or "
            f"testbeds ({', '.join(TESTBEDS)}), separated by commas."
        )
    return [mode for mode in modes() if any(mode in found for found in named.values())]


def runs_of_modes(
    wanted: Sequence[str], count: int, together: int = 1
) -> dg.MultiPartitionsDefinition:
    """Return ``count`` runs of each of some modes, so many together in a partition."""
    numbers = [range(first, min(first + together, count)) for first in range(0, count, together)]
    return dg.MultiPartitionsDefinition(
        {
            "mode": dg.StaticPartitionsDefinition(wanted),
            "run": dg.StaticPartitionsDefinition([runs_name(runs) for runs in numbers]),
        }
    )


RUNS = runs_of_modes(
    chosen_modes(os.environ), run_count(os.environ), runs_per_partition(os.environ)
)
for broken in left_out():
    dg.get_dagster_logger().warning(f"Left out: {broken}")
