"""Formats verdicts as text and JSON, and gives the exit code."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from oracle_pipeline.bags.terminal import aligned_lines, count_of
from oracle_pipeline.scoring.alarms import RATE_PER_H
from oracle_pipeline.scoring.sentences import far_out, headline, rounded
from oracle_pipeline.scoring.verdict import Evidence, Judgement, Verdict

if TYPE_CHECKING:
    from oracle_pipeline.detectors import FamilyDeviation

# From the best to the worst; the worst of a suite counts.
EXIT_CODES: dict[Judgement, int] = {
    "normal": 0, "breach": 1, "anomalous": 1, "unsupported": 2, "another system": 2, "error": 2,
}  # fmt: skip
_SHOWN: dict[Judgement, str] = {
    "normal": "normal",
    "breach": "BREACH",
    "anomalous": "ANOMALOUS",
    "unsupported": "NO VERDICT",
    "another system": "ANOTHER SYSTEM",
    "error": "COULD NOT JUDGE",
}
_TALLIED: dict[Judgement, str] = {
    "unsupported": "without a verdict", "another system": "of another system",
    "error": "not judged",
}  # fmt: skip
_WIDTH = len("NO VERDICT")

BREACH = (
    "Breach: not anomalous by its features, but topics, rates, parameters, constant fields, copied "
    "or repeated messages or the graph are not as in all normal recordings."
)

MOST_TOLD = 10  # breaches of the contract, or notes, that are shown at once

_REST = "; --format json lists all"
_MOST_NOTES = 8  # on the reference that are shown below verdicts

HEADINGS = ("feature", "value", "usual (5-95 %)", "z", "window", "where")


def exit_code(verdicts: Sequence[Verdict]) -> int:
    """Return 0 if all are normal, 1 if one is anomalous or a breach, 2 if one has no verdict."""
    return EXIT_CODES[worst(verdicts)]


def worst(verdicts: Sequence[Verdict]) -> Judgement:
    """Return the worst outcome."""
    return max((verdict.outcome for verdict in verdicts), key=list(EXIT_CODES).index)


def tally(verdicts: Sequence[Verdict]) -> str:
    """Return how many verdicts of each kind there are, the worst kind first.

    Examples
    --------
    >>> tally([Verdict("a", "normal"), Verdict("b", "anomalous"), Verdict("c", "normal")])
    '1 anomalous, 2 normal'
    """
    counts = Counter(verdict.outcome for verdict in verdicts)
    found = [(kind, counts[kind]) for kind in reversed(EXIT_CODES) if counts[kind]]
    return ", ".join(f"{count} {_TALLIED.get(kind, kind)}" for kind, count in found)


def as_json(verdicts: Sequence[Verdict], far: float, notes: Sequence[str]) -> str:
    """Return one JSON object: the worst outcome, and each verdict with its basis."""
    document = {
        "outcome": worst(verdicts),
        "false_alarm_rate": far,
        "notes": list(notes),
        "recordings": [
            # `oracle features` prints all windows
            {**{k: v for k, v in asdict(each).items() if k != "series"}, "summary": headline(each)}
            for each in verdicts
        ],
    }
    return json.dumps(document, indent=2, allow_nan=False)


def in_brief(verdicts: Sequence[Verdict]) -> str:
    """Return a line for each recording that is not normal."""
    return "".join(
        f"{_SHOWN[each.outcome]}  {each.recording}: {headline(each)}\n"
        for each in verdicts
        if each.outcome != "normal"
    )


def as_text(
    verdicts: Sequence[Verdict],
    far: float,
    notes: Sequence[str],
    *,
    together: bool = False,
    verbose: bool = False,
) -> str:
    """Return a paragraph for each verdict, the remarks that all share, and the first notes.

    `together` is as for ``scoring.judging.score``, `verbose` as for `paragraph`.
    """
    judged = [_remarks(verdict) for verdict in verdicts if verdict.p_value is not None]
    shared = [remark for remark in judged[0] if all(remark in j for j in judged)] if judged else []
    lines = [line for each in verdicts for line in paragraph(each, shared, verbose=verbose)]
    if judged:
        lines += ["", _rule(len(judged), far, together=together)]
        if any(verdict.aspects for verdict in verdicts):
            lines.append(
                "The p-values of tampering (altered messages) and of misbehaviour (what the robot "
                f"did) are each {far:g} or less in at most {far:.0%} of normal recordings."
            )
    if any(verdict.outcome == "breach" for verdict in verdicts):
        lines.append(BREACH)
    lines += first(shared, "note", _REST)
    lines += first(notes, "note", f" on the reference{_REST}", _MOST_NOTES)
    return "\n".join([*lines, *cards(verdicts), ""])


def cards(verdicts: Sequence[Verdict]) -> list[str]:
    """Return a sentence on each reference card of some verdicts."""
    return list(dict.fromkeys(str(each.card) for each in verdicts if each.card is not None))


def _rule(judged: int, far: float, *, together: bool) -> str:
    """Say when a recording is anomalous, and how many of several would be by chance."""
    rule = f"Anomalous: p <= {far:g}"
    if judged == 1:
        return f"{rule}."
    if together:
        return f"{rule}, adjusted for a suite of {judged} (Benjamini-Hochberg)."
    return f"{rule}. Of {judged} normal recordings, {far * judged:.2g} would be by chance."


def _remarks(verdict: Verdict) -> list[str]:
    """Return the basis of a verdict, then its notes."""
    basis = (
        f"Compared on {verdict.features} features with {verdict.normal_runs} normal runs of "
        f"{verdict.normal_blocks} blocks."
    )
    return [basis, *verdict.notes]


def paragraph(
    verdict: Verdict, shared: Sequence[str] = (), *, verbose: bool = False
) -> Iterator[str]:
    """Yield the lines on one verdict, without the shared remarks; verbose: on families too."""
    if verdict.p_value is None:
        yield f"{_SHOWN[verdict.outcome]}  {verdict.recording}: {headline(verdict)}"
        yield from (f"    {line}" for line in (*verdict.cautions, *verdict.differences))
        return
    suite = "" if verdict.suite_p_value == verdict.p_value else f" (alone {verdict.p_value:.3g})"
    yield (
        f"{_SHOWN[verdict.outcome].ljust(_WIDTH)}  {verdict.recording}  "
        f"p = {verdict.suite_p_value:.3g}{suite}, score {verdict.score:.3g}"
    )
    yield from (f"    {caution}" for caution in verdict.cautions)
    told = headline(verdict)
    is_normal = verdict.outcome == "normal"
    shown = far_out(verdict) if is_normal else verdict.evidence
    if told not in verdict.contract and (shown or not is_normal):
        yield f"    {told}"
    yield from (f"    {line}" for line in breaches(verdict, _REST))
    yield from (f"    {line}" for line in beside(verdict))
    if shown or not is_normal:
        yield from aligned_lines([HEADINGS, *map(cells, shown)], indent="    ")
    if verdict.outcome != "normal" and verbose:
        yield from (f"    {family_as_text(family)}" for family in verdict.families)
    remarks = [remark for remark in _remarks(verdict) if remark not in shared]
    yield from (f"    {line}" for line in first(remarks, "note", _REST))


def breaches(verdict: Verdict, rest: str) -> Iterator[str]:
    """Yield the first breaches of the contract; `rest` says where the others are."""
    return first(verdict.contract, "difference", f" from the contract{rest}")


def first(lines: Sequence[str], noun: str, rest: str, most: int = MOST_TOLD) -> Iterator[str]:
    """Yield the first of many lines, and how many more there are; `rest` ends that sentence."""
    yield from lines[:most]
    if (more := len(lines) - most) > 0:
        yield f"and {count_of(more, f'more {noun}')}{rest}."


def beside(verdict: Verdict) -> Iterator[str]:
    """Yield what is known beside the verdict: tampering or misbehaviour, and alarms over time."""
    scored = [
        f"{name} p = {aspect.suite_p_value:.3g} (score {aspect.score:.3g})"
        for name, aspect in verdict.aspects.items()
    ]
    if scored:
        yield f"{', '.join(scored).capitalize()}."
    yield from _alarms(verdict)


def _alarms(verdict: Verdict) -> Iterator[str]:
    """Yield a line on the alarms within the recording."""
    if not verdict.alarms or verdict.alarms_per_h is None:
        return
    times = ", ".join(f"{alarm.time_s:g} s" for alarm in verdict.alarms)
    rate = f"{verdict.alarms_per_h:.2g} false alarms per hour"
    if verdict.alarms_per_h > RATE_PER_H:
        yield (
            f"Alarm at {times}, perhaps false: the reference is too short to promise less than "
            f"{rate}."
        )
    else:
        yield f"Alarm at {times} (at most {rate} are promised)."


def cells(evidence: Evidence) -> tuple[str, ...]:
    """Return one piece of evidence as the cells of a table below `HEADINGS`."""
    unit = "" if evidence.unit == "1" else f" {evidence.unit}"
    since, until = evidence.window_start_s, evidence.window_end_s
    window = (
        "" if since is None else f"from {since:g} s" if until is None else f"{since:g}-{until:g} s"
    )
    return (
        evidence.feature,
        f"{rounded(evidence.value)}{unit}",
        f"{rounded(evidence.usual_low)} to {rounded(evidence.usual_high)}",
        _z(evidence.z, capped=evidence.capped),
        window,
        evidence.where or "",
    )


def family_as_text(family: "FamilyDeviation") -> str:
    """Return a sentence on the features of one family."""
    return (
        f"{family.family}: {family.unusual} of {family.compared} features outside their usual "
        f"range, {family.feature} farthest (z {_z(family.z, capped=family.capped)})"
    )


def _z(z: float, *, capped: bool) -> str:
    """Return a robust z as text, with a mark if it is capped."""
    return f"{z:+.1f} (capped)" if capped else f"{z:+.1f}"
