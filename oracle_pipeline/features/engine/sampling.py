"""Sampling of messages: the first of each topic in each span of some length."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine.spans import Integers

Bools: TypeAlias = NDArray[np.bool_]


class Sampler:
    """Samples the messages of some topics at one rate.

    Parameters
    ----------
    period_ns : int
        Length of the spans [ns]; 0 samples every message.
    is_sampled : ndarray of shape (n_topics,)
        Which topics are sampled.
    """

    def __init__(self, period_ns: int, is_sampled: Bools) -> None:
        self._period_ns = period_ns
        self._is_sampled = is_sampled
        self._last_span = np.full(len(is_sampled), -1)

    def due(self, topics: Integers, since_start_ns: Integers) -> Bools:
        """Return which messages of a batch are sampled; its messages are by topic and time.

        Parameters
        ----------
        topics : ndarray of shape (n,)
            Numbers of the messages' topics.
        since_start_ns : ndarray of shape (n,)
            Stamps of the messages, since the start of the recording.
        """
        return _due(topics, since_start_ns, self._period_ns, self._is_sampled, self._last_span)


@jit
def _due(
    topics: Integers, since_start_ns: Integers, period_ns: int, is_sampled: Bools, last: Integers
) -> Bools:
    """Return which messages are the first in their span; ``last`` are the topics' last spans."""
    is_due = np.zeros(len(topics), np.bool_)
    for i in range(len(topics)):
        topic = topics[i]
        if is_sampled[topic]:
            span = since_start_ns[i] // period_ns if period_ns else 0
            is_due[i] = period_ns == 0 or span != last[topic]
            last[topic] = span
    return is_due
