"""Runs all checks on a recording."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from oracle_pipeline.checks import times, values
from oracle_pipeline.checks.topic import CheckedTopic, Fault, topics_of
from oracle_pipeline.features.engine.kept_messages import KeptMessages
from oracle_pipeline.features.signals.collector import SignalCollector
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.robots.robot import find_robots

#: The checks by name; each yields the faults of one topic.
CHECKS: Mapping[str, Callable[[CheckedTopic], Iterator[Fault]]] = {
    "gap": times.gaps, "late_burst": times.late_bursts, "stamp": times.stamps,
    "stuck": values.stuck, "jump": values.jumps, "saturation": values.saturation,
    "limit": values.limits, "not_finite": values.not_finite, "quaternion": values.rotations,
    "replay": values.replays, "counter": values.counters,  # and "lost"
}  # fmt: skip
_FEWEST_TOPICS = 3  # a gap in these may be one of the recording
_MOST_NOTED = 5  # faults that are noted beside a verdict


def check_recording(path: Path, *, strict: bool = False) -> list[Fault]:
    """Return the faults of a recording, in order of time.

    Parameters
    ----------
    path : Path
        A run directory, a bag or another log.
    strict : bool
        Refuse an incomplete recording.

    Raises
    ------
    OracleError
        If it cannot be read.
    """
    with open_run(path, strict=strict) as run:
        losses = [loss.rstrip(".") for loss in run.bag.losses]
        faults = [Fault("lost", "", "", 0.0, 0.0, 1.0, "1", 1, loss) for loss in losses]
        for robot in find_robots(run.bag):
            collector = SignalCollector(robot)
            recording = KeptMessages.read(robot, (), see=collector.see)
            faults += _faults(recording, collector)
    return sorted(faults, key=_order)


def fault_sentences(recording: KeptMessages, collector: SignalCollector) -> list[str]:
    """Return the faults of a recording that was read for its features, as sentences."""
    found = sorted(_faults(recording, collector), key=_order)
    told = [f"Check: {fault.topic or 'all topics'}: {fault.text}." for fault in found[:_MOST_NOTED]]
    more = [f"`oracle check` tells {len(found) - _MOST_NOTED} more."] if found[_MOST_NOTED:] else []
    return [*told, *more]


def _faults(recording: KeptMessages, collector: SignalCollector) -> list[Fault]:
    topics = topics_of(recording, collector)
    found = [f for topic in topics for check in CHECKS.values() for f in check(topic)]
    return [*times.steps_back(recording.clock.set_back), *_joined_gaps(found, topics)]


def _order(fault: Fault) -> tuple[float, str, str]:
    return fault.start_s, fault.topic, fault.check


def _joined_gaps(faults: list[Fault], topics: list[CheckedTopic]) -> list[Fault]:
    """Replace gaps of several topics by one of the recording, if no topic has a message there."""
    gaps = [fault for fault in faults if fault.check == "gap"]
    middle_s = float(np.median([(gap.start_s + gap.end_s) / 2.0 for gap in gaps] or [0.0]))
    common = [gap for gap in gaps if gap.start_s < middle_s < gap.end_s]
    if len(common) < _FEWEST_TOPICS:
        return faults
    start_s, end_s = max(g.start_s for g in common), min(g.end_s for g in common)
    if any(np.any((topic.times_s > start_s) & (topic.times_s < end_s)) for topic in topics):
        return faults
    size = end_s - start_s
    text = f"no topic has a message for {size:.4g} s at {start_s:.2f} s: the recorder stood still"
    joined = Fault("gap", "", "", start_s, end_s, size, "s", 1, text)
    return [joined, *(fault for fault in faults if fault not in common)]
