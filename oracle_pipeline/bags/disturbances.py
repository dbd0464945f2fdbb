"""What a live recording lacks, and when its recorder was disturbed.

Messages are lost, or get a late stamp, because the recorder's machine is busy. Then the rates and
times of messages say something about that machine, and nothing about the robot.
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

_LISTED = 5  # topics with losses that are named


@dataclass(slots=True)
class Disturbances:
    """Losses and disturbed times of one recording.

    Attributes
    ----------
    lost : Counter of str
        Messages that arrived and were not recorded, by topic.
    packets : int
        Packets, of any topic, that found the network buffers of the machine full.
    spans : list of tuple
        Begin and end [s of the recording], in whole seconds and in order of time.
    """

    lost: Counter[str] = field(default_factory=Counter)
    packets: int = 0
    spans: list[tuple[float, float]] = field(default_factory=list)

    def add(self, other: "Disturbances") -> None:
        """Add the losses of another one."""
        self.lost += other.lost
        self.packets += other.packets

    def begin(self, now_s: float) -> None:
        """Begin a disturbed time, which lasts until `end` is called."""
        begin_s = float(math.floor(now_s))
        if self.spans and begin_s <= self.spans[-1][1]:
            begin_s = self.spans.pop()[0]
        self.spans.append((begin_s, math.inf))

    def end(self, now_s: float) -> None:
        """End a disturbed time, if there is one."""
        if self.spans and self.spans[-1][1] == math.inf:
            self.spans[-1] = self.spans[-1][0], math.floor(now_s) + 1.0

    def cover(self, start_s: float, end_s: float) -> bool:
        """Return whether a span of time was disturbed."""
        return any(begin_s < end_s and start_s < until_s for begin_s, until_s in self.spans)

    def loss(self) -> str:
        """Return a sentence on what was lost; empty if nothing was."""
        topics = ", ".join(f"{topic} {count}" for topic, count in self.lost.most_common(_LISTED))
        told = []
        if topics:
            told.append(f"{self.lost.total()} messages came too fast and were lost ({topics}).")
        if self.packets:
            told.append(
                f"{self.packets} packets found the network buffers of the machine full, so topics "
                "with best effort lack messages; sysctl net.core.rmem_max raises the buffers."
            )
        return " ".join(told)

    def to_dict(self, since_s: float, now_s: float) -> dict[str, Any]:
        """Return the content as values for JSON, of a recording between two times [s].

        Losses from before are left out only if nothing was disturbed since.
        """
        spans = [
            [max(0.0, begin_s - since_s), min(end_s, math.floor(now_s) + 1.0) - since_s]
            for begin_s, end_s in self.spans
            if end_s > since_s
        ]
        lost, packets = (self.lost, self.packets) if spans else (Counter(), 0)
        return {"lost": dict(lost), "lost_packets": packets, "disturbed": spans}

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Self:
        """Return the content from the values of `to_dict`; nothing if they are damaged."""
        try:
            lost = Counter({str(name): int(n) for name, n in document["lost"].items()})
            spans = [(float(begin_s), float(end_s)) for begin_s, end_s in document["disturbed"]]
            return cls(lost, int(document["lost_packets"]), spans)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
            return cls()
