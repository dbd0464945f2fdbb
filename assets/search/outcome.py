"""The output of a search: its findings, a picture, and the misses as scenarios to run."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from assets.search.closed_loop import Finding
from assets.search.impact import impacts
from oracle_pipeline.bags.layout import FINDINGS, FRONT
from oracle_pipeline.reporting.figures import COLORS, INK, drawing
from sim.fuzzing.scenario import NO_FILE, Scenario
from sim.scenarios import builtin_scenarios

PICTURE, MISSES = FRONT, "misses"
UNALTERED = "unaltered"  # the built-in scenario of normal runs without a node
_HIGHEST = 8.0  # effects above this count, and are drawn, as this one


def misses(findings: Sequence[Finding]) -> list[Finding]:
    """Return the runs with an effect that the oracle misses, the largest effect first."""
    return sorted((each for each in findings if each.is_miss), key=lambda each: -each.effect)


def save(
    folder: Path,
    findings: Sequence[Finding],
    front: Sequence[Finding],
    far: float,
    corpus: Path,
    seed: int,
) -> list[Path]:
    """Write findings, picture and corpus, and return the files of the misses.

    The files are scenarios with the found values as defaults and unique names. They become modes of
    the next campaign if ``ORACLE_SCENARIOS`` is the corpus. Attacks that alter a topic in place
    have no node, and would differ from normal runs that all have one. So the corpus also has a
    normal scenario without a node.
    """
    ran = [each for each in findings if not each.screened_out]
    document = {
        "far": far,
        "front": [each.proposal.run for each in front],
        "impacts": impacts(
            [each.proposal.values for each in ran], [min(each.effect, _HIGHEST) for each in ran]
        ),
        "findings": [dataclasses.asdict(each) for each in findings],
    }
    (folder / FINDINGS).write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    (folder / PICTURE).write_bytes(picture(findings, front))
    corpus.mkdir(parents=True, exist_ok=True)
    found, written = misses(findings), []
    for miss in found:
        name = f"{miss.proposal.document['id']}_miss{miss.proposal.run:03d}"
        path = corpus / f"{name}.yaml"
        path.write_text(_as_scenario(name, miss, seed), "utf-8")
        written.append(path)
    if any(Scenario("found", miss.proposal.document, NO_FILE).is_in_place for miss in found):
        normal = _as_yaml(builtin_scenarios()[UNALTERED].document)
        (corpus / f"{UNALTERED}.yaml").write_text(normal, "utf-8")
    return written


def _as_scenario(name: str, miss: Finding, seed: int) -> str:
    found = miss.proposal.document
    title = f"Found by a search: {found.get('title', found['id'])}"[:100]
    document = {**found, "id": name, "title": title}
    effects = ", ".join(f"{key} {value:+.3g}" for key, value in miss.effects.items())
    return (
        f"# Block {miss.proposal.block} of seed {seed}: p = {miss.p_value:.3g}, "
        f"effect {miss.effect:.2g}.\n# Compared with the run without it: {effects}.\n"
        f"{_as_yaml(document)}"
    )


def _as_yaml(document: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(document), sort_keys=False, allow_unicode=True)


def picture(findings: Sequence[Finding], front: Sequence[Finding]) -> bytes:
    """Draw effect over score, as PNG bytes; misses are at the upper left."""
    screened = [each for each in findings if each.screened_out]
    ran = [each for each in findings if not each.screened_out]
    groups = [
        ("missed by the oracle", COLORS["malicious"], "^", [f for f in ran if f.passed]),
        ("detected", COLORS["normal"], "o", [f for f in ran if not f.passed]),
        ("detected before it was run", INK, "x", screened),
    ]
    with drawing(6.0, 3.6) as (axes, png):
        if findings and max(each.score for each in findings) > 100.0:
            axes.set_xscale("symlog")  # before anything is drawn: margins are on this scale
        for label, color, marker, shown in groups:
            if shown:
                axes.plot(
                    [each.score for each in shown], [min(each.effect, _HIGHEST) for each in shown],
                    marker, color=color, markersize=4, linestyle="none",
                    label=f"{label} ({len(shown)})",
                )  # fmt: skip
        if front:
            axes.plot(
                [each.score for each in front], [min(each.effect, _HIGHEST) for each in front],
                "o", color=INK, markersize=8, markerfacecolor="none", markeredgewidth=0.8,
                linestyle="none", label="front",
            )  # fmt: skip
        axes.axhline(1.0, color=INK, linewidth=0.8, linestyle=":")
        axes.set(xlabel="score of the oracle", ylabel="effect on the task")
        if findings:
            axes.figure.legend(loc="outside upper right", ncols=2)
    return png.getvalue()
