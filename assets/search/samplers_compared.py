"""Compares a sampler with random search, at the same budget, with several seeds."""

from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from assets.search.closed_loop import Finding
from assets.search.outcome import is_miss
from assets.search.samplers import Sampler
from assets.search.study import Search
from oracle_pipeline.bags.terminal import aligned_lines


class Success(NamedTuple):
    """The result of one search."""

    misses: int
    until_third: float  # trials until the third miss; inf without one
    closest: float  # lowest score of a run with an effect; inf without one


Compared = dict[Sampler, list[Success]]  # a success for each seed


def compared(
    search: Callable[[Path, Sampler, int], Search],
    folder: Path,
    sampler: Sampler,
    seeds: Sequence[int],
    far: float,
) -> Compared:
    """Search with each seed, with the sampler and at random, in separate folders."""
    found: Compared = {sampler: [], "random": []}
    for seed in seeds:
        for name, successes in found.items():
            study = search(folder / f"{name}_{seed}", name, seed)
            successes.append(success(study.findings, far))
    return found


def success(findings: Sequence[Finding], far: float) -> Success:
    """Return a summary of the findings of a search."""
    places = np.flatnonzero([is_miss(each, far) for each in findings])
    with_effect = [each.score for each in findings if each.has_effect]
    third = float(places[2]) + 1.0 if len(places) > 2 else float("inf")
    return Success(len(places), third, min(with_effect, default=float("inf")))


def as_text(found: Compared) -> str:
    """Return a line for each seed of each sampler, and their medians."""
    heading = ("sampler", "misses", "trials until the third", "lowest score with an effect")
    rows: list[tuple[str, ...]] = [heading]
    for name, successes in found.items():
        rows += [(name, *map(_shown, each)) for each in successes]
        rows.append(
            (f"{name}, median", *(_shown(median(all_)) for all_ in zip(*successes, strict=True)))
        )
    return "\n".join(aligned_lines(rows))


def _shown(value: float) -> str:
    return "-" if value == float("inf") else f"{value:.4g}"
