"""Conventions that recorder and analysis share: names, pairs and lengths of experiments."""

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
