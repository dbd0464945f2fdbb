"""The figures that the thesis prints, for comparison with ours.

"A testing framework for evaluating behavioural correctness in robotic systems using clustering as
an oracle": 15 runs of six modes, agglomerative clustering of bootstrapped rows. Its "accuracy" is
the recall of the cluster with most of the malicious rows, and its AUC that of a hard verdict. The
false-positive rate, which it does not print, is decoded from the two, and the numbers of distinct
runs from the rates.
"""

from dataclasses import dataclass

import numpy as np

from oracle_pipeline.evaluation.clustering_result import in_words
from oracle_pipeline.evaluation.metrics import Confusion, decode_thesis_row

RUNS = 15  # of each of the six modes, half of which are attacked


@dataclass(frozen=True, slots=True)
class ThesisFigure:
    """One result of the thesis."""

    recall: float  # printed as "accuracy"
    auc: float
    source: str
    runs: int = 3 * RUNS  # distinct ones of each class

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

#: Table 5.1 by linkage and criterion. The last two rows look swapped; they are kept as printed.
GRID = {
    key: ThesisFigure(recall, auc, "Table 5.1")
    for key, recall, auc in (
        (("ward", "distance"), 0.029, 0.514),
        (("ward", "maxclust"), 0.953, 0.498),
        (("single", "distance"), 0.027, 0.513),
        (("single", "maxclust"), 0.924, 0.484),
        (("complete", "distance"), 0.027, 0.513),
        (("complete", "maxclust"), 0.924, 0.484),
        (("average", "distance"), 0.924, 0.484),
        (("average", "maxclust"), 0.027, 0.513),
    )
}

#: Table 6.1 by share of malicious rows.
RATES = {
    rate: ThesisFigure(recall, auc, "Table 6.1")
    for rate, recall, auc in (
        (0.1, 0.941, 0.496),
        (0.3, 0.953, 0.504),
        (0.5, 0.924, 0.490),
        (0.7, 0.970, 0.502),
        (0.9, 0.971, 0.506),
    )
}

#: Sections 6.2 to 6.4 by features used, all six modes.
FAMILIES = {
    "all": ThesisFigure(0.953, 0.504, "Section 6.2"),
    "structural": ThesisFigure(0.781, 0.711, "Section 6.4"),
    "contextual": ThesisFigure(0.953, 0.499, "Section 6.3"),
}

#: Table 6.2 by attacked mode and features used; contextual features alone are not reported.
PAIRWISE = {
    key: ThesisFigure(recall, auc, "Table 6.2", runs=RUNS)
    for key, recall, auc in (
        (("random_noise", "all"), 0.938, 0.533),
        (("random_noise", "structural"), 1.0, 0.9669),
        (("fake_object", "all"), 0.934, 0.4672),
        (("fake_object", "structural"), 1.0, 1.0),
        (("delayed_fakeobject", "all"), 0.866, 0.4662),
        (("delayed_fakeobject", "structural"), 0.664, 0.8318),
    )
}
