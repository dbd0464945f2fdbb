"""Whether a recording is of the kind of system that a reference was learned from.

What both have in common is the mean of three shares: of the roles, of the topics by name and type,
and of the topics by type alone, so that other names alone make no other system. Topics of the same
name and type count by the numbers that they share: logs of all robots may have one type.
"""

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from oracle_pipeline.bags.terminal import join_first
from oracle_pipeline.datasets import MINUS, SIGNALS, topic_of_signal
from oracle_pipeline.robots.robot import SHARED_TYPES
from oracle_pipeline.scoring.contract import Contract, Observation

LEAST = 0.4  # in common; other kinds of robots have up to a third, a half without one of two topics
SHOWN = 5  # differences


class Likeness(NamedTuple):
    """How much of its interfaces a recording has in common with a reference."""

    share: float  # in [0, 1]
    differences: tuple[str, ...]  # sentences, the largest first


def likeness(
    contract: Contract, seen: Observation, usual: Collection[str], own: Collection[str]
) -> Likeness:
    """Compare the interfaces of a recording with those of a reference.

    Parameters
    ----------
    contract : Contract
        Of the reference.
    seen : Observation
    usual, own : collection of str
        Columns of the reference and of the recording, with those of signals.
    """
    present = {name: kind for name, (kind, *_) in seen.topics.items() if kind not in SHARED_TYPES}
    common = {
        name: kind
        for name, kind in present.items()
        if name in contract.topics and kind in contract.topics[name].types
    }
    new = {name: kind for name, kind in present.items() if name not in common}
    gone = {
        name: terms.types[0]
        for name, terms in contract.topics.items()
        if terms.always and name not in common and terms.types[0] not in SHARED_TYPES
    }
    roles, usual_roles = {*seen.roles, *seen.instead}, contract.roles.keys()
    shares = [
        *([_share(roles, usual_roles)] if roles or usual_roles else []),
        _share([*common, *new.items()], [*common, *gone.items()]),
        _share([*common.values(), *new.values()], [*common.values(), *gone.values()]),
    ]
    numbers, usual_numbers = _numbers(own), _numbers(usual)
    alike = {
        name: _share(numbers[name], usual_numbers[name])
        for name in common
        if name in numbers and name in usual_numbers
    }
    found = [
        *_by_type(gone, "absent"),
        *_by_type(new, "new"),
        *_of_roles(usual_roles - roles, "lacks"),
        *_of_roles(roles - usual_roles, "also has"),
        *(
            (1, f"Topic {name} has other numbers.")
            for name, share in alike.items()
            if share < LEAST
        ),
    ]
    texts = [text for _, text in sorted(found, key=lambda each: -each[0])]
    share = np.mean(shares) * np.mean([*alike.values()] or [1.0])
    return Likeness(float(share), tuple(texts[:SHOWN]))


def _share(some: Iterable[object], others: Iterable[object]) -> float:
    """Return the elements in common over all elements; 1 without any."""
    a, b = Counter(some), Counter(others)
    return (a & b).total() / (a | b).total() if a or b else 1.0


def _numbers(columns: Iterable[str]) -> Mapping[str, set[str]]:
    """Return the numbers in the messages of each topic, from the columns of signals."""
    found: dict[str, set[str]] = defaultdict(set)
    for column in columns:
        if (topic := topic_of_signal(column)) and MINUS not in column:
            found[topic].add(column.removeprefix(f"{SIGNALS}{topic}/").rpartition(".")[0])
    return found


def _by_type(topics: Mapping[str, str], what: str) -> Iterator[tuple[int, str]]:
    for kind, count in Counter(topics.values()).items():
        names = join_first(sorted(name for name, of in topics.items() if of == kind))
        told = f"A topic of type {kind} is" if count == 1 else f"{count} topics of type {kind} are"
        yield count, f"{told} {what}: {names}."


def _of_roles(roles: Collection[str], what: str) -> Iterator[tuple[int, str]]:
    if roles:
        named = ", ".join(sorted(roles))
        yield len(roles), f"It {what} topics for the roles {named}."
