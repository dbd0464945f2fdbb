"""Whether the evaluation's figures may be believed: its integrity checks as asset checks.

The checks are made when `oracle_evaluation` is; here their stored results are shown.
"""

from collections.abc import Iterator
from math import isfinite

import dagster as dg

from resources.failures import clear_failures
from resources.store import RunStore

EVALUATION, TABLE = "oracle_evaluation", "checks"
CHECKS = tuple(
    dg.AssetCheckSpec(name, asset=EVALUATION, description=description)
    for name, description in {
        "sessions_score_alike": "A/A: runs of one mode in two sessions, on disjoint blocks, cannot "
        "be told apart.",
        "graphs_of_pairs_are_equal": "An attacked mode and its control show the same graphs.",
        "label_is_told_before_session": "Features tell the label more easily than the session.",
        "shuffled_labels_are_chance": "Labels permuted within blocks are not predicted.",
        "hard_negatives_pass": "Harmless changes are seldom called anomalous.",
        "shortcuts_are_apart": "No feature behind the headline tells a run by who was there.",
        "nothing_is_told_where_nothing_was_altered": "No feature behind the headline tells a "
        "passthrough from its shadow control.",
    }.items()
)


@dg.multi_asset_check(name="checks_of_evaluation", specs=CHECKS, can_subset=True)
def checks_of_evaluation(
    context: dg.AssetCheckExecutionContext, store: RunStore
) -> Iterator[dg.AssetCheckResult]:
    """Show what the evaluation found of itself; a check that is unsupported is not passed."""
    from oracle_pipeline.reporting.report import Report

    with clear_failures():
        table = Report.load(store.results(EVALUATION)).tables[TABLE]
    row_of_check = {str(row["name"]): row for row in table.to_dict("records")}
    for spec in CHECKS:
        if spec.key in context.selected_asset_check_keys:
            row = row_of_check[spec.name]
            figures = {name: float(row[name]) for name in ("figure", "figure_low", "figure_high")}
            yield dg.AssetCheckResult(
                check_name=spec.name,
                asset_key=spec.asset_key,
                passed=bool(row["status"] == "green"),
                severity=_severity(str(row["status"])),
                description=str(row["sentence"]),
                metadata={
                    "status": str(row["status"]),
                    **{name: value for name, value in figures.items() if isfinite(value)},
                },
            )


def _severity(status: str) -> dg.AssetCheckSeverity:
    """Tell apart what is wrong and what is only not known."""
    if status == "unsupported":
        return dg.AssetCheckSeverity.WARN
    return dg.AssetCheckSeverity.ERROR
