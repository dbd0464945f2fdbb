"""Keeps the time around alarms, and drops the rest, so a watch may run for weeks.

The last minutes are always on the disk, as the files of a recording whose oldest ones are deleted.
An alarm keeps them: the recording goes on for a while, and another one begins.
"""

import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from oracle_pipeline.live.recorder import Recorder
from oracle_pipeline.live.split_bag import Message


class Keep(NamedTuple):
    """What a black box keeps."""

    before_s: float  # an alarm, at least
    after_s: float  # the last alarm of a recording, at least
    most_bytes: float = math.inf  # of all kept recordings; the oldest are deleted first
    topics: frozenset[str] = frozenset()  # a message on one of them is an alarm, too


class BlackBox:
    """Decides what becomes of the recordings of a watch.

    Parameters
    ----------
    keep : Keep

    Attributes
    ----------
    kept : list of Path
        The recordings that exist, the oldest first.
    """

    def __init__(self, keep: Keep) -> None:
        self.keep = keep
        self.kept: list[Path] = []
        self._alarms: list[dict[str, Any]] = []
        self._until_s = -math.inf  # when the recording is complete

    def alarm(self, at_s: float, told: dict[str, Any]) -> None:
        """Keep the time around an alarm [s of the segment]."""
        self._alarms.append({"at_s": at_s, **told})
        self._until_s = at_s + self.keep.after_s

    def is_complete(self, recorder: Recorder, now_s: float, latched: Sequence[Message]) -> bool:
        """Return whether another recording has to begin; call it at the end of each interval.

        Parameters
        ----------
        recorder : Recorder
        now_s : float
            End of the interval [s of the segment].
        latched : sequence of Message
            What a late subscriber got so far.
        """
        if self._alarms:
            return now_s >= self._until_s
        recorder.forget(now_s, now_s - self.keep.before_s, latched)
        return bool(recorder.ended)

    def take(self, recorder: Recorder) -> bool:
        """Close a recording, and return whether it is kept; it is deleted if it has no alarm."""
        alarms, self._alarms, self._until_s = self._alarms, [], -math.inf
        begin_s = recorder.start_s
        recorder.facts["alarms"] = [{**each, "at_s": each["at_s"] - begin_s} for each in alarms]
        recorder.close()
        if not alarms:
            shutil.rmtree(recorder.path, ignore_errors=True)
            return False
        self.kept.append(recorder.path)
        while sum(map(_size_bytes, self.kept)) > self.keep.most_bytes:
            shutil.rmtree(self.kept.pop(0), ignore_errors=True)
        return True


def _size_bytes(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
