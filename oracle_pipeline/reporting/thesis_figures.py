"""The figures that the thesis prints, for comparison with ours.

"A testing framework for evaluating behavioural correctness in robotic systems using clustering as
an oracle": 15 runs of six modes, agglomerative clustering of bootstrapped rows. Its "accuracy" is
the recall of the cluster with most of the malicious rows, and its AUC that of a hard verdict. The
false-positive rate, which it does not print, is decoded from the two, and the numbers of distinct
runs from the rates.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from oracle_pipeline.evaluation.clustering_result import in_words
from oracle_pipeline.evaluation.metrics import Confusion, decode_thesis_row


@dataclass(frozen=True, slots=True)
class ThesisFigure:
    """One result of the thesis."""

    recall: float  # printed as "accuracy"
    auc: float
    source: str
    runs: int  # distinct ones of each class

    @property
    def fpr(self) -> float:
        """False-positive rate that follows from the two printed figures."""
        return decode_thesis_row(self.recall, self.auc)

    @property
    def confusion(self) -> Confusion:
        """Distinct runs by class and cluster, the whole numbers nearest to the printed rates."""
        tp, fp = round(self.recall * self.runs), round(self.fpr * self.runs)
        return Confusion(tp=tp, fp=fp, fn=self.runs - tp, tn=self.runs - fp)

    def columns(self) -> dict[str, float | str]:
        """Return the figure as table columns."""
        return {
            "thesis_recall": self.recall,
            "thesis_fpr": self.fpr,
            "thesis_auc": self.auc,
            "thesis_mcc": self.confusion.mcc,
            "thesis_runs": in_words(self.confusion),
            "thesis_source": self.source,
        }


#: Columns of a row without a result in the thesis.
NO_FIGURE: dict[str, float | str] = {
    **dict.fromkeys(("thesis_recall", "thesis_fpr", "thesis_auc", "thesis_mcc"), np.nan),
    **dict.fromkeys(("thesis_runs", "thesis_source"), ""),
}

#: Threshold of the thesis's code for each linkage, under either criterion (appendix A, cluster.py).
THRESHOLD = {"ward": 2.0, "single": 4.0, "complete": 4.0, "average": 4.0}

# By row and column; the others are those of `ThesisFigure`, in their order.
_PRINTED = pd.read_csv(
    Path(__file__).with_name("thesis_figures.csv"), comment="#", keep_default_na=False, dtype="str"
).astype({"recall": "float", "auc": "float", "runs": "int"})


def _figures(source: str) -> dict[tuple[str, str], ThesisFigure]:
    """Return the results of a table, or of sections, by row and column."""
    printed = _PRINTED[_PRINTED["source"].str.startswith(source)].set_index(["row", "column"])
    return {place: ThesisFigure(*figure) for place, *figure in printed.itertuples(name=None)}


#: Table 5.1 by linkage and criterion.
GRID = _figures("Table 5.1")
#: Table 6.1 by share of malicious rows.
RATES = {float(rate): figure for (rate, _), figure in _figures("Table 6.1").items()}
#: Sections 6.2 to 6.4 by features used, all six modes.
FAMILIES = {features: figure for (features, _), figure in _figures("Section").items()}
#: Table 6.2 by attacked mode and features used; contextual features alone are not reported.
PAIRWISE = _figures("Table 6.2")
