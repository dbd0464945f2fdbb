"""A picture of a comparison: a strip plot of both sets for each differing feature."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.comparison.set_comparison import Difference, SetComparison
from oracle_pipeline.reporting.figures import INK, SERIES, drawing

SHOWN = 16  # strips
_MARKERS = ("o", "^")


def strips(comparison: SetComparison) -> bytes:
    """Draw the recordings of both sets, one strip per differing feature, as PNG bytes.

    Each strip is scaled to the range of its values; the medians are printed beside it.
    """
    shown = comparison.differences[:SHOWN]
    with drawing(7.0, 1.1 + 0.34 * max(len(shown), 3)) as (axes, png):
        for row, difference in enumerate(shown):
            for set_, table in enumerate(comparison.values):
                x = _scaled(difference, comparison.values)[set_]
                label = f"{'AB'[set_]}: {comparison.recordings[set_]} recordings"
                axes.plot(
                    x, np.full(len(table), row + 0.16 * (2 * set_ - 1)), _MARKERS[set_],
                    color=SERIES[set_], markersize=3.5, alpha=0.7, linestyle="none",
                    label=None if row else label,
                )  # fmt: skip
            axes.text(
                1.03, row, f"{difference.first:.3g} → {difference.second:.3g}  {difference.unit}",
                va="center", color=INK, fontsize=7.5,
            )  # fmt: skip
        axes.set(xlim=(-0.02, 1.02), ylim=(max(len(shown), 1) - 0.4, -0.6), xticks=[])
        axes.set_yticks(range(len(shown)), [each.feature for each in shown])
        axes.tick_params(left=False)
        for side in axes.spines.values():
            side.set_visible(False)
        if shown:
            axes.figure.legend(loc="outside upper right", ncols=2)
        else:
            axes.text(0.5, 0.0, "no feature differs", ha="center", va="center")
    return png.getvalue()


def _scaled(
    difference: Difference, values: tuple[pd.DataFrame, pd.DataFrame]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the values of one feature in both sets, from 0 to 1."""
    both = [table[difference.feature].to_numpy(dtype=np.float64) for table in values]
    values_of_both = np.concatenate(both)
    low, high = np.nanmin(values_of_both), np.nanmax(values_of_both)
    first, second = ((each - low) / (high - low) for each in both)
    return first, second
