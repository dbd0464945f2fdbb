"""The tables of the HTML page: columns, headings and formats.

``oracle_pipeline.reporting.html`` assembles the page.
"""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import NamedTuple

import pandas as pd

from oracle_pipeline.detectors import FamilyDeviation
from oracle_pipeline.evaluation.comparisons import ALL_MODES, HARD_NEGATIVES, HEADLINE
from oracle_pipeline.evaluation.estimate import Estimate
from oracle_pipeline.evaluation.splits import BLOCK
from oracle_pipeline.reporting.explanation import Explanation
from oracle_pipeline.reporting.report import Report
from oracle_pipeline.scoring.output import HEADINGS, cells
from oracle_pipeline.scoring.verdict import Evidence

NO_FIGURE = "n/a"


class PageCell(NamedTuple):
    """One cell of a table: its text and, smaller, its interval."""

    text: str
    interval: str = ""


class PageColumn(NamedTuple):
    """One column of a table, below a group heading."""

    title: str
    name: str  # of the DataFrame's column
    group: str = ""
    spec: str = ""  # number format; by default two digits with an interval, else three


class PageTable(NamedTuple):
    """A table ready for the page."""

    title: str
    groups: Sequence[tuple[str, int]]  # heading, columns below it
    columns: Sequence[PageColumn]
    rows: Sequence[Sequence[PageCell]]
    notes: Sequence[str] = ()  # the column of notes has their numbers


THESIS = "The thesis"
_NEVER = "never"  # an infinite time
_NOTE = PageColumn("note", "note")
_COUNTS = (
    PageColumn("attacked runs", "malicious"),
    PageColumn("normal runs", "normal"),
    PageColumn("blocks", "blocks"),
)
_HELD_OUT = PageColumn("held out by", "split")
_AT_5, _AT_1 = "at a false positive rate of 5%", "at 1%"
_VERDICTS = (
    PageColumn("comparison", "scope"),
    _HELD_OUT,
    *_COUNTS,
    PageColumn("AUC", "auc"),
    PageColumn("detection rate", "detection_rate_5", _AT_5),
    PageColumn("realised false alarms", "false_alarm_rate_5", _AT_5),
    PageColumn("lower bound, one-sided", "false_alarm_rate_5_bound", _AT_5),
    PageColumn("detection rate", "detection_rate_1", _AT_1),
    PageColumn("realised false alarms", "false_alarm_rate_1", _AT_1),
    PageColumn("blocks missing", "blocks_lacking_1", _AT_1),
    _NOTE,
)
_ALARMS = (
    PageColumn("comparison", "scope"),
    PageColumn("attacked runs", "attacked_runs"),
    PageColumn("AUC of windows", "auc"),
    PageColumn("missed", "missed"),
    PageColumn("median", "time_to_detect_median_s", "time to detect [s]", ".1f"),
    PageColumn("90th percentile", "time_to_detect_90_s", "time to detect [s]", ".1f"),
    PageColumn("median, after a change", "after_effect_median_s", "time to detect [s]", ".1f"),
    PageColumn("promised at most", "promised_per_h", "false alarms per hour", ".2g"),
    PageColumn("realised", "false_alarms_per_h", "false alarms per hour"),
)
_CALLED = (
    PageColumn("tampered", "called_tampering", "share called, at 5%"),
    PageColumn("misbehaved", "called_misbehaviour", "share called, at 5%"),
    PageColumn("both", "called_both", "share called, at 5%"),
)
_QUADRANTS = (
    PageColumn("tampered", "tampered", "truth"),
    PageColumn("misbehaved", "misbehaved", "truth"),
    PageColumn("runs", "runs"),
    *_CALLED,
)
_ASPECTS_BY_MODE = (
    PageColumn("mode", "mode"),
    PageColumn("runs compared", "runs"),
    PageColumn("misbehaved", "misbehaved", "truth"),
    PageColumn("task effect over its uncertainty, median", "effect_median", "truth", ".2f"),
    *_CALLED,
    PageColumn("tampered", "untaught_tampering", "the same, hard negatives held out"),
    PageColumn("misbehaved", "untaught_misbehaviour", "the same, hard negatives held out"),
)
_ASPECTS = (
    PageColumn("score", "aspect"),
    PageColumn("comparison", "scope"),
    PageColumn("runs to find", "malicious"),
    PageColumn("others", "normal"),
    PageColumn("AUC", "auc"),
    PageColumn("detection rate", "detection_rate_5", _AT_5),
    PageColumn("realised false alarms", "false_alarm_rate_5", _AT_5),
    _NOTE,
)
_SCORER = (
    PageColumn("detector", "detector"),
    PageColumn("features", "features"),
    PageColumn("level", "level"),
    _HELD_OUT,
)
_OVER_ALL = (
    PageColumn("AUC", "auc"),
    PageColumn("average precision", "average_precision"),
    PageColumn("detection rate", "detection_rate_5", _AT_5),
    PageColumn("realised false alarms", "false_alarm_rate_5", _AT_5),
    PageColumn("MCC", "mcc_5", _AT_5),
    _NOTE,
)
_GIVEAWAYS = (
    PageColumn("mode", "mode"),
    PageColumn("feature", "feature"),
    PageColumn("attacked runs outside", "outside"),
    PageColumn("normal runs outside", "normal"),
    PageColumn("median z", "median_z", spec="+.1f"),
)
_FAMILIES = (
    PageColumn("family", "family"),
    PageColumn("features outside", "outside"),
    PageColumn("farthest", "farthest"),
    PageColumn("z", "z", spec="+.1f"),
)
_SMALL_CLUSTERS = (
    PageColumn("linkage", "linkage"),
    PageColumn("clusters over runs", "kappa", spec="g"),
    PageColumn("clusters", "clusters"),
    PageColumn("attacked of the runs in small clusters", "failure_share"),
    PageColumn("attacked runs found", "found"),
    PageColumn("runs inspected", "inspected"),
    PageColumn("found in a quarter of the runs", "found_in_budget"),
    PageColumn("ARI", "ari", spec="z.2f"),
    _NOTE,
)
_OPERATOR = (PageColumn("scenario", "scenario"), PageColumn("parameter", "parameter"))
_MUTATION_SCORES = (
    *_SCORER,
    PageColumn("mutants", "mutants"),
    PageColumn("killed", "killed"),
    PageColumn("mutation score", "mutation_score"),
)
_MAGNITUDES = (*_SCORER, *_OPERATOR, PageColumn("smallest detected", "magnitude", spec=".3g"))
_KILLS = (
    *_OPERATOR,
    _HELD_OUT,
    PageColumn("magnitude", "value", spec="g"),
    PageColumn("mutants", "mutants"),
    PageColumn("equivalent", "equivalent"),
    PageColumn("killed", "killed"),
    PageColumn("kill rate", "kill_rate"),
)

_REPRODUCED, _CORRECTED = "its method on our runs", "the method corrected, on our runs"
_SIDE_BY_SIDE = (
    PageColumn("source", "thesis_source"),
    PageColumn("experiment", "experiment"),
    PageColumn("recall", "thesis_recall", THESIS),
    PageColumn("FPR", "thesis_fpr", THESIS),
    PageColumn("hard AUC", "thesis_auc", THESIS),
    PageColumn("MCC", "thesis_mcc", THESIS, "z.2f"),
    PageColumn("runs", "thesis_runs", THESIS),
    PageColumn("recall", "reproduced_recall", _REPRODUCED),
    PageColumn("FPR", "reproduced_fpr", _REPRODUCED),
    PageColumn("hard AUC", "reproduced_auc", _REPRODUCED),
    PageColumn("MCC", "reproduced_mcc", _REPRODUCED, "z.2f"),
    PageColumn("runs", "reproduced_runs", _REPRODUCED),
    PageColumn("TPR", "corrected_tpr", _CORRECTED),
    PageColumn("FPR", "corrected_fpr", _CORRECTED),
    PageColumn("AUC of the height", "corrected_auc", _CORRECTED),
    PageColumn("MCC", "corrected_mcc", _CORRECTED, "z.2f"),
    _NOTE,
)
_NULL_MODEL = (
    PageColumn("share of very long runs", "p_long", spec=".0%"),
    PageColumn("recall", "recall"),
    PageColumn("FPR", "fpr"),
    PageColumn("hard AUC", "auc"),
    PageColumn("experiments that reach the thesis's recall", "reaches_headline", spec=".0%"),
)
_HEIGHT, _VERDICT, _BEST = "AUC", "Verdict without labels", "The thesis's reading of our runs"
_MEASURES = (
    PageColumn("recall", "recall_best_cluster", _BEST),
    PageColumn("FPR", "fpr_best_cluster", _BEST),
    PageColumn("hard AUC", "balanced_accuracy_best_cluster", _BEST),
    PageColumn("recall", "thesis_recall", THESIS),
    PageColumn("FPR", "thesis_fpr", THESIS),
    PageColumn("hard AUC", "thesis_auc", THESIS),
    PageColumn("TPR", "tpr", _VERDICT),
    PageColumn("FPR", "fpr", _VERDICT),
    PageColumn("balanced accuracy", "balanced_accuracy", _VERDICT),
    PageColumn("MCC", "mcc", _VERDICT, "z.2f"),
    PageColumn("accuracy", "accuracy", _VERDICT, ".2f"),
    PageColumn("F1", "f1", _VERDICT, ".2f"),
    PageColumn("HAC height", "auc", _HEIGHT),
    _NOTE,
)
_GRID_SEARCH = (
    PageColumn("metric", "metric"),
    PageColumn("linkage", "linkage"),
    PageColumn("criterion", "criterion"),
    PageColumn("t", "t", spec="g"),
)
_RATES = (PageColumn("malicious rows", "malicious_rate", spec=".0%"),)
_PAIRS = (PageColumn("runs", "scope"), PageColumn("features", "features"))


def of_evaluation(evaluation: Report) -> dict[str, PageTable]:
    """Return the tables of `oracle_evaluation` by name, with those of a grid if there is one."""
    table, more = evaluation.table, evaluation.tables
    headline = _of_headline(table)
    against = [scope for scope in headline["scope"] if "/" in scope]
    areas = [PageColumn(scope, scope) for scope in against]
    if "kills" in more:  # the other oracles are in the picture
        more = {**more, "kills": more["kills"][_is_headline(more["kills"])]}
    grids = {
        "verdicts": grid("Verdicts of the headline's scorer", headline, _VERDICTS),
        "alarms": grid("Alarms during a run", more["alarms"], _ALARMS),
        "scorers": grid(
            "Over all modes", table[table["scope"] == ALL_MODES], (*_SCORER, *_OVER_ALL)
        ),
        "families": grid(
            "AUC of each attack by one family",
            _areas(table[_is_by_family(table)], against),
            (PageColumn("features", "features"), *areas),
        ),
        "areas": grid("AUC of each attack", _areas(table, against), (*_SCORER, *areas)),
        "small_clusters": grid("Small clusters", more["small_clusters"], _SMALL_CLUSTERS),
    }
    more = {
        name: table
        for name, table in more.items()
        if name not in ("quadrants", "aspects_by_mode") or table["runs"].any()
    }
    for name, title, columns in (
        ("quadrants", "Tampered and misbehaved runs", _QUADRANTS),
        ("aspects_by_mode", "The same, by mode", _ASPECTS_BY_MODE),
        ("aspects", "Each score against its own ground truth", _ASPECTS),
        ("minimum_detectable", "Smallest detected magnitude", _MAGNITUDES),
        ("mutation_scores", "Mutation scores", _MUTATION_SCORES),
        ("kills", f"Kills by {HEADLINE.detector} on {HEADLINE.features} features", _KILLS),
    ):
        if name in more:
            grids[name] = grid(title, more[name], columns)
    return grids


def of_thesis(
    *, grid_search: Report, rates: Report, pairs: Report, side_by_side: Report, null_model: Report
) -> dict[str, PageTable]:
    """Return the tables that follow the thesis's method, by name."""
    return {
        "side_by_side": grid(
            "Printed results of the thesis, and both variants", side_by_side.table, _SIDE_BY_SIDE
        ),
        "null_model": grid("Meaningless labels", null_model.table, _NULL_MODEL),
        "grid": grid("Grid search", grid_search.table, (*_GRID_SEARCH, *_MEASURES)),
        "rates": grid("Malicious rates", rates.table, (*_RATES, *_MEASURES)),
        "pairs": grid("Pairs and features", pairs.table, (*_PAIRS, *_MEASURES)),
    }


def of_explanation(explanation: Explanation) -> PageTable:
    """Return the evidence for a run, one feature in each row."""
    return of_evidence(f"What is unusual in {explanation.run_id}", explanation.evidence)


def of_evidence(title: str, evidence: Iterable[Evidence]) -> PageTable:
    """Return pieces of evidence, one feature in each row."""
    columns = [PageColumn(heading, heading) for heading in HEADINGS]
    rows = [[PageCell(text) for text in cells(each)] for each in evidence]
    return PageTable(title, [("", len(columns))], columns, rows)


def of_families(families: Iterable[FamilyDeviation]) -> PageTable:
    """Return how many features of each family are unusual."""
    table = pd.DataFrame(
        [
            (each.family, f"{each.unusual} of {each.compared}", each.feature, each.z)
            for each in families
        ],
        columns=["family", "outside", "farthest", "z"],
    )
    return grid("Families of features", table, _FAMILIES)


def of_giveaways(giveaways: pd.DataFrame) -> PageTable:
    """Return the features that show each attacked mode; only its first row has the mode's name."""
    repeated = giveaways.duplicated("mode")
    shown = giveaways.assign(
        mode=giveaways["mode"].mask(repeated, ""),
        outside=giveaways["outside"].astype(str) + " of " + giveaways["runs"].astype(str),
        normal=giveaways["outside_normal"].astype(str) + " of " + giveaways["normal"].astype(str),
    )
    return grid("Features that show attacks", shown, _GIVEAWAYS)


def of_any(title: str, table: pd.DataFrame) -> PageTable:
    """Return a table with all of its columns under their own names."""
    return grid(title, table, [PageColumn(str(n).replace("_", " "), str(n)) for n in table.columns])


def grid(title: str, table: pd.DataFrame, columns: Iterable[PageColumn]) -> PageTable:
    """Return a table with those of the columns that have any value."""
    shown = [column for column in columns if _has_values(table, column.name)]
    groups = [(name, len(list(members))) for name, members in groupby(shown, lambda c: c.group)]
    number: dict[str, str] = {}
    if _NOTE in shown:
        notes = dict.fromkeys(filter(None, table[_NOTE.name]))
        number = {note: str(n) for n, note in enumerate(notes, start=1)}
        table = table.assign(**{_NOTE.name: table[_NOTE.name].map(number).fillna("")})
    rows = [[_cell(row, column) for column in shown] for _, row in table.iterrows()]
    return PageTable(title, groups, shown, rows, list(number))


def _has_values(table: pd.DataFrame, name: str) -> bool:
    return name in table.columns and bool((table[name].notna() & (table[name] != "")).any())


def _cell(row: pd.Series, column: PageColumn) -> PageCell:
    value = row[column.name]
    if f"{column.name}_low" in row.index:
        text, _, interval = f"{Estimate.of_row(row, column.name):{column.spec}}".partition(" ")
        return PageCell(*(part.replace("inf", _NEVER) for part in (text, interval)))
    if not isinstance(value, float):
        return PageCell(str(value))
    return PageCell(NO_FIGURE if pd.isna(value) else f"{value:{column.spec or '.3f'}}")


def _of_headline(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the headline's scorer; for other splits only the overall rows."""
    overall = table["scope"].isin([ALL_MODES, HARD_NEGATIVES])
    return table[_is_headline(table) & ((table["split"] == BLOCK) | overall)]


def _is_headline(table: pd.DataFrame) -> pd.Series:
    return (table[list(HEADLINE._fields)] == list(HEADLINE)).all(axis=1)


def _is_by_family(table: pd.DataFrame) -> pd.Series:
    """Return the rows of the headline's detector and level, held out by block."""
    fixed = ["detector", "level", "split"]
    return (table[fixed] == [HEADLINE.detector, HEADLINE.level, BLOCK]).all(axis=1)


def _areas(table: pd.DataFrame, scopes: Sequence[str]) -> pd.DataFrame:
    """Return one row for each scorer, with its AUC in each scope under the scope's name."""
    key = [column.name for column in _SCORER]
    joined = table[key].drop_duplicates().set_index(key)
    for scope in scopes:
        of_scope = table[table["scope"] == scope].set_index(key)
        for end in ("", "_low", "_high"):
            joined[f"{scope}{end}"] = of_scope[f"auc{end}"]
    return joined.reset_index()
