"""The claims that a campaign cannot support yet, the reasons, and which runs to record."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

import pandas as pd

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bootstrap import lacking
from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.evaluation.card_verdicts import RATE, blocks_for_verdicts
from oracle_pipeline.evaluation.integrity_checks import IntegrityCheck


@dataclass(frozen=True, slots=True)
class OpenClaim:
    """A claim that these runs do not support yet."""

    claim: str
    reason: str
    modes: tuple[str, ...] = ()  # to record
    blocks: int = 0  # number of blocks to record them in; 0: the reason says what to do


def open_claims(df: pd.DataFrame, checks: Sequence[IntegrityCheck]) -> list[OpenClaim]:
    """Return what these runs cannot support, the most basic claim first.

    Parameters
    ----------
    df : DataFrame
        Distinct runs, one row each.
    checks : sequence of IntegrityCheck
        Of their evaluation. Their sentences say which runs they need.
    """
    if missing := lacking(df):
        side = 0 if is_malicious(df).any() else 1
        absent = tuple(pair[side] for pair in PAIRS)
        blocks = max(1, df["block"].nunique())
        return [OpenClaim("Any comparison", f"There are {missing}.", absent, blocks)]
    claims = []
    blocks, needed = df.loc[~is_malicious(df), "block"].nunique(), blocks_for_verdicts()
    if blocks < needed:
        reason = (
            f"It needs normal recordings of {needed} blocks; you have {blocks}. Record "
            f"{needed - blocks} more blocks."
        )
        modes = tuple(dict.fromkeys(df["mode"]))
        claims.append(OpenClaim(f"A false positive rate of {RATE:.0%}", reason, modes, needed))
    for status, claim, what in (
        ("unsupported", "All integrity checks", "lack runs"),
        ("red", "A detection rate for other recordings than these", "fail"),
    ):
        names = [check.name.replace("_", " ") for check in checks if check.status == status]
        if names:
            claims.append(OpenClaim(claim, f"These checks {what}: {', '.join(names)}."))
    return claims


def as_table(claims: Iterable[OpenClaim]) -> pd.DataFrame:
    """Return claims as a table, modes joined by spaces."""
    rows = [{**asdict(claim), "modes": " ".join(claim.modes)} for claim in claims]
    return pd.DataFrame(rows, columns=list(OpenClaim.__dataclass_fields__))
