"""Formats a comparison as text, JSON, JUnit XML, and as the comment on a pull request."""

import dataclasses
import json
import re
from collections.abc import Iterator, Sequence

from oracle_pipeline.bags.terminal import aligned_lines, count_of, printable
from oracle_pipeline.comparison.set_comparison import (
    ComparisonOutcome,
    Difference,
    SetComparison,
    fewest,
)
from oracle_pipeline.scoring.junit import TestCase, junit_document
from oracle_pipeline.scoring.sentences import told_apart

EXIT_CODES: dict[ComparisonOutcome, int] = {"same": 0, "different": 1, "unsupported": 2}
SHOWN = 20  # differences in a text; JSON has all
_NEXT: dict[ComparisonOutcome, str] = {
    "same": "Next: nothing to look at. More recordings would show smaller differences.",
    "different": "Next: oracle replay shows a recording.",
    "unsupported": "Next: record more, and compare again.",
}

_HEADINGS = ("feature", "A", "B", "B - A", "95 % interval", "effect", "p")


def as_json(comparison: SetComparison) -> str:
    """Return one JSON object: outcome, numbers of compared features, and all differences."""
    document = {
        field.name: getattr(comparison, field.name)
        for field in dataclasses.fields(comparison)
        if field.name != "differences"
    }
    document["differences"] = [dataclasses.asdict(each) for each in comparison.differences]
    return json.dumps(document, indent=2, allow_nan=False)


def as_text(comparison: SetComparison) -> str:
    """Return the outcome as a sentence, the differences as a table, and the method."""
    lines = [_in_words(comparison)]
    if comparison.differences:
        shown = comparison.differences[:SHOWN]
        lines += ["", *aligned_lines([_HEADINGS, *map(_cells, shown)], indent="    ")]
        if more := len(comparison.differences) - len(shown):
            lines.append(f"    and {more} more; --format json lists all")
    lines += ["", *_basis(comparison), *comparison.notes, _NEXT[comparison.outcome]]
    return "\n".join(lines)


def as_markdown(comparison: SetComparison, links: Sequence[str] = ()) -> str:
    """Return a comment for a pull request: what changed, by how much, and what did not change.

    Parameters
    ----------
    comparison : SetComparison
        A is the branch to merge into, B the one to merge.
    links : sequence of str
        Addresses to put below, such as of films.
    """
    shown = comparison.differences[:SHOWN]
    lines = [f"### {_title(comparison)}", ""]
    if shown:
        lines += ["| feature | before | after | change (95 %) | p, corrected |", "| --- " * 5 + "|"]
        lines += [_row(difference) for difference in shown]
        if more := len(comparison.differences) - len(shown):
            lines.append(f"\nand {more} more")
        lines.append("")
    changed = {each.family for each in comparison.differences}
    same = [f"{name} ({n})" for name, n in comparison.compared.items() if name not in changed]
    if same and comparison.outcome != "unsupported":
        lines += [f"**Did not change:** {', '.join(same)}.", ""]
    lines += ["<details><summary>How this was measured</summary>", ""]
    lines += [*map(_plain, (*_basis(comparison), *comparison.notes)), "", "</details>"]
    return "\n".join([*lines, *(f"\n{link}" for link in links)])


def _title(comparison: SetComparison) -> str:
    if not comparison.differences:
        return _in_words(comparison)
    first, more = comparison.differences[0], len(comparison.differences) - 1
    unit = "" if first.unit == "1" else f" {first.unit}"
    others = f", and {count_of(more, 'more feature')} changed" if more else ""
    return (
        f"The behaviour changed: {_code(first.feature)} went from "
        f"{' to '.join(told_apart(first.first, first.second))}{unit} "
        f"(p = {first.p_value:.2g}){others}"
    )


def _row(difference: Difference) -> str:
    feature, before, after, shift, interval, _, p = _cells(difference)
    return f"| {_code(feature)} | {before} | {after} | {shift} ({interval}) | {p} |"


def _code(name: str) -> str:
    """Return a name from a recording as inline code, without what would end it or its cell."""
    return f"`{re.sub('[`|]', '?', printable(name))}`"


def _plain(text: str) -> str:
    """Return a text with names of recordings in it, without markup."""
    return re.sub(r"([\\`*_<>\[\]@#|])", r"\\\1", printable(text))


def _in_words(comparison: SetComparison) -> str:
    """Return the outcome as one sentence."""
    total = sum(comparison.compared.values())
    if comparison.outcome == "unsupported":
        paired = bool(comparison.pairs)
        needed = fewest(comparison.level, paired=paired)
        return (
            f"NO VERDICT: too few recordings to show a difference at {comparison.level:.3g} "
            f"(smallest p-value {comparison.lowest_p:.2g}). Record {needed} "
            f"{'pairs' if paired else 'for each set'}, or raise --level."
        )
    if comparison.outcome == "same":
        return f"NO DIFFERENCE in {total} features at {comparison.level:.3g}."
    return f"DIFFERENT: {len(comparison.differences)} of {total} features."


def as_junit(comparison: SetComparison) -> bytes:
    """Return JUnit XML with a test case per family of features; it fails if a feature differs."""
    cases = []
    for family in comparison.compared:
        rows = [_cells(each) for each in comparison.differences if each.family == family]
        if comparison.outcome == "unsupported":
            cases.append(TestCase(family, "error", _in_words(comparison)))
        elif rows:
            text = "\n".join(aligned_lines([_HEADINGS, *rows]))
            cases.append(TestCase(family, "failure", text))
        else:
            cases.append(TestCase(family))
    return junit_document("oracle compare", cases)


def _basis(comparison: SetComparison) -> Iterator[str]:
    first, second = comparison.recordings
    yield f"A: {first} recordings, B: {second}. " + (
        f"Compared in {comparison.pairs} pairs of equal blocks."
        if comparison.pairs
        else "Compared as two sets."
    )
    yield (
        f"If the sets do not differ, the probability of any difference here is at most "
        f"{comparison.level:.3g} (permutation test). Effect, from -1 to 1: how often the value is "
        "larger in B, minus how often it is smaller."
    )


def _cells(difference: Difference) -> tuple[str, ...]:
    unit = "" if difference.unit == "1" else f" {difference.unit}"
    return (
        difference.feature,
        f"{difference.first:.4g}{unit}",
        f"{difference.second:.4g}{unit}",
        f"{difference.shift:+.3g}",
        f"{difference.low:+.3g} to {difference.high:+.3g}",
        f"{difference.effect:+.2f}",
        f"{difference.p_value:.2g}",
    )
