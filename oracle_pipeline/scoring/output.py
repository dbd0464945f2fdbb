"""Verdicts on recordings as text for people and JSON for programs, and the exit code."""

import dataclasses
import json
from collections.abc import Iterator, Sequence

from oracle_pipeline.bags.terminal import aligned_lines
from oracle_pipeline.detectors import FamilyDeviation
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.conformal import runs_needed
from oracle_pipeline.scoring.verdict import Evidence, Judgement, Verdict

# The worst of a suite counts.
EXIT_CODES: dict[Judgement, int] = {"normal": 0, "anomalous": 1, "unsupported": 2, "error": 2}
_SHOWN: dict[Judgement, str] = {
    "normal": "normal",
    "anomalous": "ANOMALOUS",
    "unsupported": "NO VERDICT",
    "error": "COULD NOT JUDGE",
}
_WIDTH = len("NO VERDICT")

RATES = (0.05, 0.01)  # false positive rates that a card is held against

HEADINGS = ("feature", "value", "usual (5-95 %)", "z", "window", "where")


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Return 0 if all are normal, 1 if one is anomalous, 2 if one has no verdict."""
    return max(EXIT_CODES[verdict.outcome] for verdict in verdicts)


def as_json(verdicts: Sequence[Verdict], far: float, notes: Sequence[str]) -> str:
    """Return one JSON object: the worst outcome, and each verdict with its basis."""
    worst = exit_code(verdicts)
    document = {
        "outcome": next(outcome for outcome, code in EXIT_CODES.items() if code == worst),
        "false_alarm_rate": far,
        "notes": list(notes),
        "recordings": [dataclasses.asdict(verdict) for verdict in verdicts],
    }
    return json.dumps(document, indent=2, allow_nan=False)


def as_text(verdicts: Sequence[Verdict], far: float, notes: Sequence[str]) -> str:
    """Return a paragraph for each verdict, then once the remarks that all of them share."""
    judged = [_remarks(verdict) for verdict in verdicts if verdict.outcome != "error"]
    shared = [remark for remark in judged[0] if all(remark in j for j in judged)] if judged else []
    lines = [line for verdict in verdicts for line in paragraph(verdict, shared)]
    if judged:
        over = f", adjusted for a suite of {len(judged)} (Benjamini-Hochberg)"
        lines += ["", f"Anomalous: p <= {far:g}{over if len(judged) > 1 else ''}."]
    return "\n".join([*lines, *shared, *notes])


def card_as_text(card: ReferenceCard) -> str:
    """Return what a card holds, which rates it supports, and what it lacks."""
    runs, scorer = card.runs, card.scorer
    blocks = runs["block"].nunique()
    lines = [
        f"Learned from {len(runs)} normal recordings of {blocks} blocks and "
        f"{runs['session'].nunique()} sessions.",
        f"Features: {len(scorer.design.run_features)} of recordings, "
        f"{len(scorer.design.window_features)} of windows.",
        _contract_as_text(card),
        *(_support(blocks, rate) for rate in RATES),
        *card.notes,
    ]
    return "\n".join(lines)


def _support(blocks: int, rate: float) -> str:
    needed = runs_needed(rate)
    if blocks >= needed:
        return f"Supports verdicts at a false positive rate of {rate:.0%}."
    return f"Supports no verdict at {rate:.0%}: {needed} blocks are needed, {needed - blocks} more."


def _contract_as_text(card: ReferenceCard) -> str:
    if card.contract is None:
        return "No contract of topics and rates: the card was learned from tables."
    terms = card.contract.topics.values()
    steady = sum(of_topic.lowest_hz is not None for of_topic in terms)
    return f"Contract: {len(terms)} topics, {steady} of them with a steady rate."


def _remarks(verdict: Verdict) -> list[str]:
    """Return the basis of a verdict, then its notes."""
    basis = (
        f"Compared on {verdict.features} features with {verdict.normal_runs} normal runs of "
        f"{verdict.normal_blocks} blocks."
    )
    return [basis, *verdict.notes]


def paragraph(verdict: Verdict, shared: Sequence[str] = ()) -> Iterator[str]:
    """Yield the lines on one verdict, without the remarks that are shared by all."""
    if verdict.outcome == "error":
        yield f"{_SHOWN[verdict.outcome]}  {verdict.recording}: {verdict.error}"
        return
    suite = "" if verdict.suite_p_value == verdict.p_value else f" (alone {verdict.p_value:.3g})"
    yield (
        f"{_SHOWN[verdict.outcome].ljust(_WIDTH)}  {verdict.recording}  "
        f"p = {verdict.suite_p_value:.3g}{suite}, score {verdict.score:.3g}"
    )
    yield from (f"    {breach}" for breach in verdict.contract)
    if verdict.outcome != "normal":
        yield from aligned_lines([HEADINGS, *map(cells, verdict.evidence)], indent="    ")
        yield from (f"    {family_summary(family)}" for family in verdict.families)
    yield from (f"    {remark}" for remark in _remarks(verdict) if remark not in shared)


def cells(evidence: Evidence) -> tuple[str, ...]:
    """Return one piece of evidence as the cells of a table below `HEADINGS`."""
    unit = "" if evidence.unit == "1" else f" {evidence.unit}"
    window = "" if evidence.window_start_s is None else f"from {evidence.window_start_s:g} s"
    return (
        evidence.feature,
        f"{evidence.value:.4g}{unit}",
        f"{evidence.usual_low:.4g} to {evidence.usual_high:.4g}",
        _z(evidence.z, capped=evidence.capped),
        window,
        evidence.where or "",
    )


def family_summary(family: FamilyDeviation) -> str:
    """Return a sentence on the features of one family."""
    return (
        f"{family.family}: {family.unusual} of {family.compared} features outside their usual "
        f"range, {family.feature} farthest (z {_z(family.z, capped=family.capped)})"
    )


def _z(z: float, *, capped: bool) -> str:
    """Return a robust z, and whether it is only as large as z may be."""
    return f"{z:+.1f} (capped)" if capped else f"{z:+.1f}"
