"""Claims that a campaign cannot support, because it is too small or lacks kinds of runs."""

from math import log

import numpy as np
import pandas as pd

from oracle_pipeline.bootstrap import lacking
from oracle_pipeline.datasets import feature_columns, is_malicious

FALSE_ALARMS = 0.05  # the rate a verdict is usually asked to keep


def limits(df: pd.DataFrame) -> list[str]:
    """Return what the runs of a table cannot support, one sentence each, worst first.

    Parameters
    ----------
    df : DataFrame
        Distinct runs, a row each.
    """
    normal = ~is_malicious(df)
    n, blocks = int(normal.sum()), df["block"].nunique()
    remarks = []
    if missing := lacking(df):
        remarks.append(f"There are {missing}: no comparison is possible. Record both.")
    to_calibrate = round(1.0 / FALSE_ALARMS) - 1
    to_show = int(np.ceil(log(FALSE_ALARMS) / log(1.0 - FALSE_ALARMS)))
    if 0 < n < to_calibrate:
        remarks.append(
            f"{n} normal runs cannot support any claim about a {FALSE_ALARMS:.0%} false-alarm "
            f"rate: {to_calibrate} are needed to set a threshold for it, and {to_show} without a "
            "false alarm to show it."
        )
    elif 0 < n < to_show:
        bound = 1.0 - FALSE_ALARMS ** (1.0 / n)
        remarks.append(
            f"{n} normal runs cannot show a {FALSE_ALARMS:.0%} false-alarm rate: without a single "
            f"false alarm the rate may still be {bound:.1%}; {to_show} runs are needed."
        )
    if blocks < 5:
        remarks.append(
            f"All runs come from {blocks} block{'s' if blocks != 1 else ''} (start, goals and "
            "nuisance seed): results may not carry over to others."
        )
    if df["session"].nunique() < 2 and len(df):
        remarks.append("All runs come from one session: drift between sessions cannot be seen.")
    empty = [name for name in feature_columns(df) if not np.isfinite(df[name]).any()]
    if empty:
        remarks.append(f"No run has a value for {', '.join(empty)}; left out.")
    return remarks
