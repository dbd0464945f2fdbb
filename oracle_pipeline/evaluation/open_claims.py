"""The claims that a campaign cannot support yet, the reasons, and which runs to record."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from math import ceil

import numpy as np
import pandas as pd

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bootstrap import lacking
from oracle_pipeline.datasets import HARD_NEGATIVE, feature_columns, is_malicious
from oracle_pipeline.evaluation.audit import blocks_needed
from oracle_pipeline.evaluation.card_verdicts import RATE, blocks_for_verdicts
from oracle_pipeline.evaluation.comparisons import SHADOW
from oracle_pipeline.evaluation.integrity_checks import (
    FALSE_ALARMS,
    IntegrityCheck,
    blocks_to_exclude,
    blocks_to_separate,
)
from oracle_pipeline.evaluation.splits import MIN_BLOCKS
from oracle_pipeline.scoring.selection import named


@dataclass(frozen=True, slots=True)
class OpenClaim:
    """A claim that these runs do not support yet."""

    claim: str
    reason: str
    modes: tuple[str, ...] = ()  # to record; a trailing ``*`` is a wildcard
    blocks: int = 0  # number of blocks to record them in; 0: more runs do not help


def open_claims(df: pd.DataFrame, checks: Sequence[IntegrityCheck]) -> list[OpenClaim]:
    """Return what these runs cannot support, the most basic claim first.

    Parameters
    ----------
    df : DataFrame
        Distinct runs, one row each.
    checks : sequence of IntegrityCheck
        Of their evaluation.
    """
    if missing := lacking(df):
        side = 0 if is_malicious(df).any() else 1
        absent = tuple(pair[side] for pair in PAIRS)
        blocks = max(1, df["block"].nunique())
        return [OpenClaim("Any comparison", f"There are {missing}.", absent, blocks)]
    return [
        *_verdicts(df),
        *_checks(df, [check for check in checks if check.status != "green"]),
        *_unused(df),
    ]


def as_table(claims: Iterable[OpenClaim]) -> pd.DataFrame:
    """Return claims as a table, modes joined by spaces."""
    rows = [{**asdict(claim), "modes": " ".join(claim.modes)} for claim in claims]
    return pd.DataFrame(rows, columns=list(OpenClaim.__dataclass_fields__))


def _verdicts(df: pd.DataFrame) -> list[OpenClaim]:
    """Return why the false positive rate is not supported, or not proven."""
    normal = df[~is_malicious(df)]
    modes = tuple(dict.fromkeys(df["mode"]))
    runs, blocks = len(normal), normal["block"].nunique()
    needed = blocks_for_verdicts()
    if blocks < needed:
        reason = (
            f"It needs normal recordings of {needed} blocks; you have {runs} recordings of "
            f"{blocks}. Record {needed - blocks} more blocks."
        )
        return [OpenClaim(f"A false positive rate of {RATE:.0%}", reason, modes, needed)]
    to_show = blocks_to_exclude(RATE)
    if runs < to_show:
        bound = 1.0 - RATE ** (1.0 / runs)
        reason = (
            f"{runs} normal recordings without a false positive would still allow a rate of "
            f"{bound:.1%}; {to_show} are needed."
        )
        needed = ceil(to_show * blocks / runs)
        return [OpenClaim(f"Proof that the rate is at most {RATE:.0%}", reason, modes, needed)]
    return []


def _checks(df: pd.DataFrame, doubts: Sequence[IntegrityCheck]) -> list[OpenClaim]:
    """Return the checks that are not green, starting with those that need other runs."""
    claims = []
    lacks = [check for check in doubts if check.status == "unsupported"]
    if lacks:
        needs = [_need(check.name, df) for check in lacks]
        modes = tuple(dict.fromkeys(mode for of_check, _ in needs for mode in of_check))
        blocks = max(blocks for _, blocks in needs)
        reason = f"These checks lack runs: {', '.join(map(_named, lacks))}."
        everything = tuple(dict.fromkeys([*df["mode"], *modes]))
        claims.append(OpenClaim("All integrity checks", reason, everything, blocks))
    if failed := [check for check in doubts if check.status == "red"]:
        reason = f"These checks fail: {', '.join(map(_named, failed))}."
        claims.append(OpenClaim("A detection rate for other recordings than these", reason))
    return claims


def _named(check: IntegrityCheck) -> str:
    return check.name.replace("_", " ")


def _need(check: str, df: pd.DataFrame) -> tuple[tuple[str, ...], int]:
    """Return the modes that a check needs, and the number of blocks."""
    if check == "hard_negatives_pass":
        return (f"{HARD_NEGATIVE}*",), blocks_to_exclude(FALSE_ALARMS)
    if check == "unaltered_runs_are_alike":
        shadows = tuple(f"{attacked}{SHADOW}" for _, attacked in PAIRS)
        return shadows, blocks_needed(len(feature_columns(df)))
    if check == "sessions_score_alike":
        can_help = df["session"].nunique() < df["block"].nunique()  # sessions of several blocks
        return (), df["session"].nunique() * blocks_to_separate() if can_help else 0
    if check == "graphs_of_pairs_are_equal":
        return tuple(mode for pair in PAIRS for mode in pair), max(1, df["block"].nunique())
    return (), MIN_BLOCKS


def _unused(df: pd.DataFrame) -> list[OpenClaim]:
    """Name features without a value, but no family that has none: these robots lack its topics."""
    columns = feature_columns(df)
    has_value = np.isfinite(df[columns].to_numpy(dtype=np.float64)).any(axis=0)
    families = {name.partition(".")[0] for name in itertools.compress(columns, has_value)}
    empty = [
        name
        for name in itertools.compress(columns, ~has_value)
        if name.partition(".")[0] in families
    ]
    if not empty:
        return []
    return [OpenClaim("Anything by features without a value", f"No run has {named(empty)}.")]
