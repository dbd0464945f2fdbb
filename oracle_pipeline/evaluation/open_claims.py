"""The claims that a campaign cannot support yet, the reasons, and which runs to record."""

from collections.abc import Sequence

import pandas as pd

from oracle_pipeline.bags.protocol import PAIRS
from oracle_pipeline.bootstrap import lacking
from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.evaluation.card_verdicts import RATE, blocks_for_verdicts
from oracle_pipeline.evaluation.integrity_checks import IntegrityCheck

COLUMNS = ("claim", "reason", "modes", "blocks")


def open_claims(df: pd.DataFrame, checks: Sequence[IntegrityCheck]) -> pd.DataFrame:
    """Return what these runs cannot support, the most basic claim first.

    Parameters
    ----------
    df : DataFrame
        Distinct runs, one row each.
    checks : sequence of IntegrityCheck
        Of their evaluation. Their sentences say which runs they need.

    Returns
    -------
    DataFrame
        ``claim``, ``reason``, the ``modes`` to record, and in how many ``blocks``; 0 where the
        reason says what to do.
    """
    if missing := lacking(df):
        side = 0 if is_malicious(df).any() else 1
        absent = " ".join(pair[side] for pair in PAIRS)
        row = ("Any comparison", f"There are {missing}.", absent, max(1, df["block"].nunique()))
        return pd.DataFrame([row], columns=COLUMNS)
    claims: list[tuple[str, str, str, int]] = []
    blocks, needed = df.loc[~is_malicious(df), "block"].nunique(), blocks_for_verdicts()
    if blocks < needed:
        reason = (
            f"It needs normal recordings of {needed} blocks; you have {blocks}. Record "
            f"{needed - blocks} more blocks."
        )
        modes = " ".join(dict.fromkeys(df["mode"]))
        claims.append((f"A false positive rate of {RATE:.0%}", reason, modes, needed))
    for status, claim, what in (
        ("unsupported", "All integrity checks", "lack runs"),
        ("red", "A detection rate for other recordings than these", "fail"),
    ):
        names = [check.name.replace("_", " ") for check in checks if check.status == status]
        if names:
            claims.append((claim, f"These checks {what}: {', '.join(names)}.", "", 0))
    return pd.DataFrame(claims, columns=COLUMNS)
