"""The clock of a recording without its jumps.

A recorder's clock may be set while it records: from 0 to the simulation's time, by NTP, by a month
when the robot finds a network. A recording is then a sequence of spans. Features see the spans one
after the other, without the gaps between them. Within a span, times do not change.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Stamps: TypeAlias = NDArray[np.int64]

_SECOND_NS = 1_000_000_000
#: A silence of all topics that is longer is a jump, unless the recording is as sparse throughout.
_JUMP_NS = 60 * _SECOND_NS
_SPARSE = 100  # median silences; longer ones are jumps
_BACK_NS = _SECOND_NS  # that a topic goes back when the clock was set; threads differ by less
_FEWEST = 10  # messages of a topic that is asked whether the clock went back


@dataclass(frozen=True, slots=True)
class Timeline:
    """The spans of a recording, in order of time within each epoch."""

    epochs: tuple[int, ...]  # of each span: how often the clock had been set back before
    starts_ns: tuple[int, ...]  # stamp of the first message
    ends_ns: tuple[int, ...]  # of the last

    @property
    def duration_ns(self) -> int:
        """From the start to a nanosecond after the end, without jumps."""
        return sum(self._lengths())

    def times_ns(self, stamps_ns: Stamps, epochs_of: list[Stamps]) -> Stamps:
        """Return the times of messages since the start of the recording [ns].

        Parameters
        ----------
        stamps_ns : ndarray of shape (n,)
            Topic by topic.
        epochs_of : list of ndarray
            Of each topic.
        """
        times_ns = stamps_ns - self.starts_ns[0]
        if len(self.starts_ns) == 1:
            return times_ns
        epochs = np.concatenate(epochs_of)
        offset_ns = 0
        for epoch, start_ns, end_ns, length_ns in zip(
            self.epochs, self.starts_ns, self.ends_ns, self._lengths(), strict=True
        ):
            inside = (epochs == epoch) & (stamps_ns >= start_ns) & (stamps_ns <= end_ns)
            times_ns[inside] = stamps_ns[inside] - start_ns + offset_ns
            offset_ns += length_ns
        return times_ns

    @property
    def set_back(self) -> tuple[tuple[float, float], ...]:
        """When the clock was set back, since the start of the recording, and by how much [s]."""
        ends_s = np.cumsum(self._lengths())[:-1] / _SECOND_NS
        back_s = (np.array(self.ends_ns[:-1]) - np.array(self.starts_ns[1:])) / _SECOND_NS
        steps = zip(ends_s.tolist(), back_s.tolist(), strict=True)
        return tuple((at_s, by_s) for at_s, by_s in steps if by_s > 0.0)

    def note(self) -> str | None:
        """Return a note on the jumps of the clock; None without any."""
        if len(self.starts_ns) == 1:
            return None
        spans = ", ".join(
            f"{start_ns / 1e9:.3f} to {end_ns / 1e9:.3f} s"
            for start_ns, end_ns in list(zip(self.starts_ns, self.ends_ns, strict=True))[:5]
        )
        return (
            f"The recorder's clock jumps or the recording pauses: {len(self.starts_ns)} spans "
            f"({spans}{', ...' if len(self.starts_ns) > 5 else ''}) are read one behind the other."
        )

    def _lengths(self) -> list[int]:
        return [e - s + 1 for s, e in zip(self.starts_ns, self.ends_ns, strict=True)]


def timeline(stamps_ns: list[Stamps], epochs: list[Stamps], start_ns: int, end_ns: int) -> Timeline:
    """Split a recording into spans where its clock jumps.

    Parameters
    ----------
    stamps_ns, epochs : list of array
        Of each topic, in any order of time.
    start_ns, end_ns : int
        Stamps of the first and the last message, other topics' included.
    """
    last = max((int(of.max(initial=0)) for of in epochs), default=0)
    # If the clock was set back, stamps do not give the order of messages.
    ends_ns = np.array([] if last else [start_ns, end_ns], dtype=np.int64)
    spans: list[tuple[int, int, int]] = []
    for epoch in range(last + 1):
        own = [
            stamps[of == epoch] if last else stamps
            for stamps, of in zip(stamps_ns, epochs, strict=True)
        ]
        ordered = np.concatenate([ends_ns, *own])
        if not ordered.size:
            continue
        ordered.sort()
        silences = np.diff(ordered)
        longest_ns = _JUMP_NS
        if silences.size and silences.max() > _JUMP_NS:
            longest_ns = max(_JUMP_NS, _SPARSE * int(np.median(silences[silences > 0])))
        cuts = np.flatnonzero(silences > longest_ns)
        starts, ends = ordered[[0, *(cuts + 1)]].tolist(), ordered[[*cuts, -1]].tolist()
        spans += [(epoch, start, end) for start, end in zip(starts, ends, strict=True)]
    numbers, starts, ends = zip(*spans, strict=True)
    return Timeline(tuple(numbers), tuple(starts), tuple(ends))


def epochs(stamps_ns: list[Stamps]) -> list[Stamps]:
    """Return how often the clock had been set back before each message.

    Parameters
    ----------
    stamps_ns : list of array
        Of each topic, in file order. Half of those with ten messages have to go back, all equally
        often: a topic alone is one that was stored late.
    """
    back = [np.diff(stamps, prepend=stamps[:1]) < -_BACK_NS for stamps in stamps_ns]
    often = [int(steps.sum()) for steps in back if len(steps) >= _FEWEST]
    jumps = int(np.median(often)) if often else 0
    if not jumps or often.count(jumps) * 2 < len(often):
        return [np.broadcast_to(np.int64(0), len(stamps)) for stamps in stamps_ns]
    counted: list[Stamps] = [np.cumsum(steps, dtype=np.int64) for steps in back]
    spans = _spans(stamps_ns, counted, jumps)
    return [
        epoch if len(epoch) and epoch[-1] == jumps else _nearest(stamps, spans)
        for stamps, epoch in zip(stamps_ns, counted, strict=True)
    ]


def _spans(stamps_ns: list[Stamps], counted: list[Stamps], jumps: int) -> list[tuple[int, int]]:
    """Return first and last stamp of each epoch, from topics with messages in all of them."""
    whole = [
        (stamps, epoch)
        for stamps, epoch in zip(stamps_ns, counted, strict=True)
        if len(epoch) and epoch[-1] == jumps
    ]
    return [
        (
            min(int(stamps[epoch == number].min()) for stamps, epoch in whole),
            max(int(stamps[epoch == number].max()) for stamps, epoch in whole),
        )
        for number in range(jumps + 1)
    ]


def _nearest(stamps: Stamps, spans: list[tuple[int, int]]) -> Stamps:
    """Return the epoch that contains each stamp, or the nearest one."""
    apart = [np.maximum(np.maximum(start - stamps, stamps - end), 0) for start, end in spans]
    nearest: Stamps = np.argmin(np.stack(apart), axis=0).astype(np.int64)
    return nearest
