"""Conventions that recorder and analysis share: names, pairs and lengths of experiments."""

import re

PAIRS: tuple[tuple[str, str], ...] = (
    ("lidar_passthrough", "random_noise"),
    ("lidar_passthrough_odom", "fake_object"),
    ("delayed_passthrough", "delayed_fakeobject"),
)
"""Modes whose graphs are equal by construction: the control, and the attack."""

INTERVAL_S = 10
"""Length of the intervals for which graphs are taken, from the start of the recording [s]."""

MIN_INTERVAL_S = 5
"""A last, partial interval shorter than this is dropped [s]."""


def is_hidden(topic: str) -> bool:
    """Return whether a name is hidden by the ROS convention (a token starts with ``_``)."""
    return "/_" in topic


def run_key(mode: str, run: int) -> str:
    """Return the name of a run below a root, its partition key: ``fake_object|run003``."""
    return f"{mode}|run{run:03d}"


def runs_name(runs: range) -> str:
    """Return the name of consecutive runs: ``run003``, or ``run000-249`` for several."""
    last = f"-{runs[-1]:03d}" if len(runs) > 1 else ""
    return f"run{runs[0]:03d}{last}"


def runs_named(name: str) -> range | None:
    """Return the runs that `runs_name` names; None if it does not name runs.

    Examples
    --------
    >>> runs_named("run003"), runs_named("run000-249"), runs_named("notes")
    (range(3, 4), range(0, 250), None)
    """
    match = re.fullmatch(r"run(\d{3,})(?:-(\d{3,}))?", name)
    return range(int(match[1]), int(match[2] or match[1]) + 1) if match else None
