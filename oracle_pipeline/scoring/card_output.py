"""Describes a reference card as text: what it was learned from, and what it promises."""

import math

import numpy as np

from oracle_pipeline.bags.terminal import aligned_lines, count_of
from oracle_pipeline.scoring.alarms import RATE_PER_H
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.conformal import runs_needed
from oracle_pipeline.scoring.evidence import ranked_deviations, usual_ranges
from oracle_pipeline.scoring.selection import recordings_for

RATES = (0.05, 0.01)  # false positive rates for which missing blocks are reported
_OUTLYING = 5.0  # spreads of the normal scores above their median
_MOST_OUTLIERS = 5  # recordings of a card that are listed


def card_as_text(card: ReferenceCard) -> str:
    """Describe the content of a card and the false positive rates that it supports."""
    runs, design = card.runs, card.scorer.design
    blocks, sessions = runs["block"].nunique(), runs["session"].nunique()
    lines = [
        f"Learned from {count_of(len(runs), 'normal recording')}: {count_of(blocks, 'block')}, "
        f"{count_of(sessions, 'session')}.",
        *([f"Detector: {design.named}, on plain statistics of signals."] if design.named else []),
        f"Features: {len(design.run_features) if design.uses_features else 0} of whole recordings, "
        f"{len(design.window_features)} of windows, {len(design.run_signals)} of signals.",
        f"Scores beside the verdict: {', '.join(card.aspects) or 'none'}.",
        _support(blocks),
        _survives(),
        _alarms_as_text(card),
        _contract_as_text(card),
        *_roles_as_text(card),
        *_outliers_as_text(card),
        *card.notes,
    ]
    return "\n".join(lines)


def terms_as_text(card: ReferenceCard) -> list[str]:
    """Return the roles and the contract of a card, a line for each role and each topic."""
    if card.contract is None:
        return []
    roles = [f"    {role}: {', '.join(names)}" for role, names in card.contract.roles.items()]
    rows = [
        (
            name,
            " or ".join(terms.types),
            "" if terms.lowest_hz is None else f"{terms.lowest_hz:.3g}-{terms.highest_hz:.3g} Hz",
            "" if terms.always else "not in all recordings",
            count_of(len(fields), "constant field")
            if (fields := card.contract.constants.get(name))
            else "",
            f"copies {', '.join(of)}" if (of := card.contract.relays.get(name)) else "",
        )
        for name, terms in card.contract.topics.items()
    ]
    heads = ["Roles:", *roles] if roles else ["Roles: none"]
    return [*heads, "Topics:", *aligned_lines(rows, indent="    ")]


def lowest_far(card: ReferenceCard) -> float:
    """Return the lowest false positive rate at which a card supports a verdict, to 3 digits."""
    return math.ceil(1000.0 / (card.runs["block"].nunique() + 1)) / 1000.0


def _roles_as_text(card: ReferenceCard) -> list[str]:
    if card.roles is None:
        return []
    robots = () if card.roles.robots is None else (f"robots {', '.join(card.roles.robots)}",)
    chosen = [f"{role} {', '.join(names) or 'none'}" for role, names in card.roles.topics.items()]
    return [f"Roles file, used for scoring too: {'; '.join([*robots, *chosen])}."]


def _support(blocks: int) -> str:
    """Describe which false positive rates the blocks support, and how many more others need."""
    lacking = [
        f"{rate:.0%} needs {count_of(runs_needed(rate) - blocks, 'more block')}"
        for rate in RATES
        if blocks < runs_needed(rate)
    ]
    supported = f"Verdicts: at a false positive rate of {1.0 / (blocks + 1):.2g} or more"
    return f"{'; '.join([supported, *lacking])}."


def _survives() -> str:
    """Describe how many recordings verdicts need if some of them are odd."""
    one, two, three = (recordings_for(count, runs_needed(RATES[0])) for count in (1, 2, 3))
    return (
        f"Odd recordings: at {RATES[0]:.0%}, {one} recordings survive one that is unlike all "
        f"others, {two} two and {three} three."
    )


def _alarms_as_text(card: ReferenceCard) -> str:
    """Describe the rate of false alarms that the recordings support."""
    windows = card.scorer.windows_
    if windows is None:
        return "No alarms within a recording: windows are not compared."
    lowest = windows.lowest_rate()
    if lowest <= RATE_PER_H:
        return f"Alarms within a recording: at most {RATE_PER_H:g} false alarms per hour."
    return (
        f"Alarms within a recording: at most {lowest:.2g} false alarms per hour; {RATE_PER_H:g} "
        f"per hour needs {lowest / RATE_PER_H:.0f} times as many hours of normal recordings."
    )


def _contract_as_text(card: ReferenceCard) -> str:
    if card.contract is None:
        return "No contract of topics and rates: the card was learned from tables."
    terms = card.contract.topics.values()
    steady = sum(of_topic.lowest_hz is not None for of_topic in terms)
    told = f"Contract: {count_of(len(terms), 'topic')}, {steady} of them with a steady rate."
    if card.breaching is None:
        return told
    recordings = count_of(len(card.runs), "recording")
    told = f"{told} {card.breaching} of {recordings} break the contract of the others."
    if not card.contract.unsteady:
        return told
    unsteady = ", ".join(sorted(card.contract.unsteady))
    return f"{told} Only noted, as normal recordings differ in it: {unsteady}."


def _outliers_as_text(card: ReferenceCard) -> list[str]:
    """List the recordings that may not be normal: a failed one among them hides attacks."""
    scores = card.scorer.held_out_
    found = [row for row in np.argsort(-scores, kind="stable") if scores[row] >= _OUTLYING]
    if not found:
        return []
    return [
        f"Unlike the others: {count_of(len(found), 'recording')}. Each raises the score that an "
        "attack must exceed. Remove failed recordings, and learn again.",
        *(_outlier_as_text(card, row) for row in found[:_MOST_OUTLIERS]),
    ]


def _outlier_as_text(card: ReferenceCard, row: int) -> str:
    """Return score and most unusual feature of a recording, compared with other blocks."""
    runs, design = card.runs, card.scorer.design
    others = runs[runs["block"] != runs["block"].iloc[row]]
    usual = usual_ranges(others, design.run_features, design.run_signals, design.floors)
    deviations = ranked_deviations(usual, runs.iloc[[row]])
    told = [f", {each.feature} = {each.value:.3g}" for each in deviations[:1]]
    return f"    {runs['run_id'].iloc[row]}: score {card.scorer.held_out_[row]:.3g}{''.join(told)}"
