"""Formats a comparison as text, JSON and JUnit XML."""

import dataclasses
import json
from collections.abc import Iterator

from oracle_pipeline.bags.terminal import aligned_lines
from oracle_pipeline.comparison.measurements import family_of
from oracle_pipeline.comparison.set_comparison import (
    ComparisonOutcome,
    Difference,
    SetComparison,
    fewest,
)
from oracle_pipeline.scoring.junit import TestCase, junit_document

EXIT_CODES: dict[ComparisonOutcome, int] = {"same": 0, "different": 1, "unsupported": 2}
SHOWN = 20  # differences in a text; JSON has all

_HEADINGS = ("feature", "A", "B", "B - A", "95 % interval", "effect", "p")


def as_json(comparison: SetComparison) -> str:
    """Return one JSON object: outcome, numbers of compared features, and all differences."""
    document = {
        field.name: getattr(comparison, field.name)
        for field in dataclasses.fields(comparison)
        if field.name not in ("values", "differences")
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
        lines += ["", *(f"    {line}" for line in _by_family(comparison))]
    return "\n".join([*lines, "", *_basis(comparison), *comparison.notes])


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


def _by_family(comparison: SetComparison) -> Iterator[str]:
    for family, compared in comparison.compared.items():
        found = sum(family_of(each.feature) == family for each in comparison.differences)
        if found:
            yield f"{family}: {found} of {compared} features differ"


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
