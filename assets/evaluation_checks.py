"""The integrity checks of the evaluation, as asset checks.

`oracle_evaluation` computes them; this module reports the stored results.
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
        "sessions_score_alike": (
            "A/A test: runs of one mode in two sessions, on disjoint blocks, have similar scores."
        ),
        "graphs_of_pairs_are_equal": "An attacked mode and its control have the same ROS graphs.",
        "hard_negatives_pass": (
            "Runs with a harmless change (hard negatives) are rarely called anomalous."
        ),
        "unaltered_runs_are_alike": (
            "No feature of the headline distinguishes a passthrough from its shadow control."
        ),
    }.items()
)


@dg.multi_asset_check(name="checks_of_evaluation", specs=CHECKS, can_subset=True)
def checks_of_evaluation(
    context: dg.AssetCheckExecutionContext, store: RunStore
) -> Iterator[dg.AssetCheckResult]:
    """Return the results of the integrity checks; an unsupported check does not pass."""
    from oracle_pipeline.reporting.stored_report import Report

    with clear_failures():
        table = Report.load(store.results(EVALUATION)).tables[TABLE]
    row_of_check = {str(row["name"]): row for row in table.to_dict("records")}
    status = table["status"].tolist()
    context.log.info(
        f"{status.count('green')} of {len(status)} integrity checks are green, "
        f"{status.count('red')} red; {status.count('unsupported')} need more runs."
    )
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
    """Return the severity: a warning for an unsupported check, an error for a failed one."""
    if status == "unsupported":
        return dg.AssetCheckSeverity.WARN
    return dg.AssetCheckSeverity.ERROR
