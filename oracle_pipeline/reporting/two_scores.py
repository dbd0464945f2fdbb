"""Tampering and misbehaviour of single runs: the two scores beside the ground truth.

Scores and ground truth come from ``oracle_pipeline.evaluation``: ``aspects`` and ``task_effects``.
This module formats them for the pages of runs.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from oracle_pipeline.bags.behaviour import UNITS, behaviour
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.terminal import count_of
from oracle_pipeline.evaluation.card_verdicts import RATE
from oracle_pipeline.evaluation.task_effects import REPEATS
from oracle_pipeline.reporting.tables import NO_FIGURE, PageTable, plain_table
from oracle_pipeline.reporting.templating import number
from oracle_pipeline.scoring.feature_sets import ASPECTS

_QUESTIONS = {
    "tampering": "Tampering: do its messages agree with each other?",
    "misbehaviour": "Misbehaviour: did the robot act as usual?",
}
_CALLED = {"tampering": "tampered", "misbehaviour": "misbehaved"}


def scores_table(
    judged: pd.Series, manifest: Manifest, uncertainty: Mapping[str, float]
) -> PageTable:
    """Return the two scores of a run beside the ground truth.

    Parameters
    ----------
    judged : Series
        The run's row of the table ``runs``, with its differences from unaltered runs of the block.
    manifest : Manifest
    uncertainty : mapping of str to float
        Distance between unaltered runs, by quantity.
    """
    truth = {"tampering": _tampered(manifest), "misbehaviour": _misbehaved(judged, uncertainty)}
    rows = [
        (
            _QUESTIONS[aspect],
            number(judged[f"{aspect}_score"]),
            number(judged[f"{aspect}_p"]),
            _verdict(aspect, judged[f"{aspect}_p"]),
            truth[aspect],
        )
        for aspect in ASPECTS
    ]
    heads = ["two questions", "score", "p", f"called at {RATE:.0%}", "in truth"]
    return plain_table("Tampering and misbehaviour", pd.DataFrame(rows, columns=heads))


def task_table(
    judged: pd.Series | None, manifest: Manifest, uncertainty: Mapping[str, float]
) -> PageTable:
    """Return the robot's behaviour by quantity; empty if it has no goals.

    Parameters are those of `scores_table`; a run that was not judged has no differences.
    """
    beside = manifest.task_effect or {}
    differences = pd.Series(dtype=float) if judged is None else judged
    rows = [
        (
            _name(quantity),
            number(value, unit=_unit(quantity)),
            number(beside.get(quantity, np.nan), "+.3g"),
            number(differences.get(quantity, np.nan), "+.3g"),
            number(uncertainty.get(quantity, np.nan)),
        )
        for quantity, value in behaviour(manifest).items()
    ]
    heads = ["quantity", "this run", "more than control", "more than unaltered", "usual up to"]
    return plain_table("What the robot did", pd.DataFrame(rows, columns=heads))


def _tampered(manifest: Manifest) -> str:
    if manifest.label != "malicious":
        return "not tampered"
    changed = sum(change.messages for change in manifest.changes)
    return f"tampered: the attack altered {count_of(changed, 'message')}"


def _misbehaved(judged: pd.Series, uncertainty: Mapping[str, float]) -> str:
    """Return a text on the quantities in which the robot's behaviour differs."""
    if np.isnan(judged["effect"]):
        return f"unknown: it needs {REPEATS} unaltered runs, one of them in this block"
    if judged["effect"] <= 1.0:
        return "did not misbehave: like unaltered runs of its block"
    different = [
        f"{_name(quantity)} {number(judged[quantity], '+.3g', _unit(quantity))}"
        for quantity in UNITS
        if abs(judged[quantity]) > uncertainty[quantity]
    ]
    return f"misbehaved: {', '.join(different)}"


def _verdict(aspect: str, p: float) -> str:
    if np.isnan(p):
        return NO_FIGURE
    return _CALLED[aspect] if p <= RATE else f"not {_CALLED[aspect]}"


def _name(quantity: str) -> str:
    return quantity.removesuffix(f"_{UNITS[quantity]}").replace("_", " ")


def _unit(quantity: str) -> str:
    return "" if UNITS[quantity] == "1" else UNITS[quantity]
