"""The ground truth of a scenario: a message for each input message, and a summary."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from oracle_pipeline.bags.manifest import Change
from oracle_pipeline.bags.types import GROUND_TRUTH_TYPE, message_class
from sim.middleware.executor import SECOND
from sim.middleware.stamps import time_message

_BIN_NS = 5 * SECOND  # length of the bins in which changes are counted

_GroundTruth = message_class(GROUND_TRUTH_TYPE)


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """The change of one message, or the action of a timer."""

    stamp_ns: int  # of the message's header, else when it was published
    topic: str
    index: int  # how many messages had been published on the topic before
    operation: str
    magnitude: float  # the largest change, in the operation's own unit; 0 if there is none
    detail: str

    def message(self) -> Any:
        """Return ``oracle_msgs/msg/GroundTruth``."""
        return _GroundTruth(
            time_message(self.stamp_ns), self.topic, self.index, self.operation, self.magnitude,
            self.detail,
        )  # fmt: skip


def in_bins(changes: Iterable[tuple[int, float]], start_ns: int) -> tuple[Change, ...]:
    """Return the changes in bins of five seconds from the start of the recording.

    Parameters
    ----------
    changes
        When [ns], in order, and the magnitude; earlier times are left out.
    start_ns
        Of the recording.
    """
    bins: dict[int, list[float]] = {}
    for time_ns, magnitude in changes:
        if time_ns >= start_ns:
            bins.setdefault((time_ns - start_ns) // _BIN_NS, []).append(magnitude)
    return tuple(
        Change(number * _BIN_NS / SECOND, len(found), _finite(max(found)))
        for number, found in bins.items()
    )


def _finite(magnitude: float) -> float | None:
    return magnitude if math.isfinite(magnitude) else None
