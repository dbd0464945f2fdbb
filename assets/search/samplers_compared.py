"""Compares a sampler with random search, at the same budget, with several seeds."""

from collections.abc import Callable, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np

from assets.search.closed_loop import Finding
from assets.search.outcome import is_miss
from assets.search.search import Sampler
from oracle_pipeline.bags.terminal import aligned_lines


class _Success(NamedTuple):
    """The result of one search."""

    misses: float
    until_third: float  # trials until the third miss; inf without one
    closest: float  # lowest score of a run with an effect; inf without one


def compared(
    search: Callable[[Sampler, int], Sequence[Finding]],
    sampler: Sampler,
    seeds: Sequence[int],
    far: float,
) -> str:
    """Search with each seed, with the sampler and at random; return all results and medians."""
    rows: list[tuple[str, ...]] = [
        ("sampler", "misses", "trials until the third", "lowest score with an effect")
    ]
    samplers: tuple[Sampler, ...] = (sampler, "random")
    for name in dict.fromkeys(samplers):
        successes = [_success(search(name, seed), far) for seed in seeds]
        rows += [(name, *map(_shown, each)) for each in successes]
        medians = map(median, zip(*successes, strict=True))
        rows.append((f"{name}, median", *map(_shown, medians)))
    return "\n".join(aligned_lines(rows))


def _success(findings: Sequence[Finding], far: float) -> _Success:
    places = np.flatnonzero([is_miss(each, far) for each in findings])
    with_effect = [each.score for each in findings if each.has_effect]
    third = float(places[2]) + 1.0 if len(places) > 2 else float("inf")
    return _Success(len(places), third, min(with_effect, default=float("inf")))


def _shown(value: float) -> str:
    return "-" if value == float("inf") else f"{value:.4g}"
