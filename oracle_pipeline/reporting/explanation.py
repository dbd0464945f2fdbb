"""Explains one run of each attack: its verdict, the evidence, and a picture.

A second picture shows the run that differs only by the attack. Evidence comes from
``oracle_pipeline.scoring.evidence``, pictures from ``oracle_pipeline.replay.picture``.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.datasets import is_hard_negative, is_malicious
from oracle_pipeline.evaluation.card_verdicts import RATE
from oracle_pipeline.evaluation.comparisons import SHADOW
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.evidence import evidence
from oracle_pipeline.scoring.verdict import Evidence

SHOWN = 3  # number of attacks
CONTROLS = {attacked: control for control, attacked in PAIRS}


@dataclass(frozen=True, eq=False, slots=True)
class Explanation:
    """One attacked run; the notes name missing evidence and pictures."""

    run_id: str
    verdict: str
    evidence: tuple[Evidence, ...]  # largest abs(z) first
    pictures: Mapping[str, bytes]  # PNG, by run
    notes: tuple[str, ...]


def explanations(
    df: pd.DataFrame,
    windows: pd.DataFrame,
    judged: pd.DataFrame,
    draw: Callable[[str], bytes],
) -> list[Explanation]:
    """Explain one run for each of at most three attacks, those of control pairs first.

    Parameters
    ----------
    df : DataFrame
        Distinct runs, one row each.
    windows : DataFrame
        Their windows, one row each.
    judged : DataFrame
        ``run_id``, ``mode``, ``label``, ``score`` and ``p`` of each judged run (the table ``runs``
        of `oracle_evaluation`).
    draw : callable
        Takes a run and returns its picture as PNG; an `OracleError` becomes a note.
    """
    attacked = judged[is_malicious(judged)]
    attacked_modes = sorted(set(attacked["mode"]))
    modes = [mode for mode in dict.fromkeys([*CONTROLS, *attacked_modes]) if mode in attacked_modes]
    return [
        _explanation(_typical(attacked[attacked["mode"] == mode]), df, windows, draw)
        for mode in modes[:SHOWN]
    ]


def _typical(runs: pd.DataFrame) -> pd.Series:
    """Return the run with the median score among the detected runs, or else among all."""
    detected = runs[runs["p"] <= RATE]
    ranked = (detected if len(detected) else runs).sort_values(["score", "run_id"])
    return ranked.iloc[(len(ranked) - 1) // 2]


def _explanation(
    chosen: pd.Series, df: pd.DataFrame, windows: pd.DataFrame, draw: Callable[[str], bytes]
) -> Explanation:
    run, notes = str(chosen["run_id"]), []
    row = df[df["run_id"] == run]
    farthest: tuple[Evidence, ...] = ()
    try:
        farthest = evidence(FeatureTables(row, windows[windows["run_id"] == run]), df)
    except OracleError as error:
        notes.append(str(error))
    pictures, undrawn = drawn([run, *counterpart(run, df)], draw)
    verdict = _verdict(float(chosen["p"]))
    return Explanation(run, verdict, farthest, pictures, (*notes, *undrawn))


def drawn(runs: Iterable[str], draw: Callable[[str], bytes]) -> tuple[dict[str, bytes], list[str]]:
    """Return the pictures of runs, and the reasons for missing ones."""
    pictures, undrawn = {}, []
    for run in runs:
        try:
            pictures[run] = draw(run)
        except (OracleError, OSError) as error:
            undrawn.append(f"{run} is not drawn: {error}")
    return pictures, undrawn


def counterpart(run: str, df: pd.DataFrame) -> list[str]:
    """Return the run of the same block without the attack, if there is one.

    This is the attack's control; for attacks without one, the shadow or else the block's first
    normal run that is not a hard negative.

    Parameters
    ----------
    run : str
        An attacked run.
    df : DataFrame
        ``run_id``, ``mode`` and ``label`` of the runs of one testbed, sorted by run.
    """
    mode, number = run.split("|")
    control = f"{CONTROLS.get(mode, f'{mode}{SHADOW}')}|{number}"
    normal = df.loc[(df["label"] == "normal") & ~is_hard_negative(df), "run_id"]
    of_block = [other for other in normal if other.endswith(f"|{number}")]
    return [other for other in (control, *of_block) if other in set(df["run_id"])][:1]


def _verdict(p: float) -> str:
    if np.isnan(p):
        return f"Not judged: there are too few normal runs for a verdict at {RATE:.0%}."
    called = "Called" if p <= RATE else "Not called"
    return f"{called} anomalous at a false positive rate of {RATE:.0%}: p = {p:.3g}."
