"""All assets, checks, resources, jobs, schedules and sensors in one ``Definitions``.

Only Dagster and tests import this module. ``build_defs`` accepts replacements of default resources,
so tests and scripts need no patching.
"""

import os
import warnings

import dagster as dg

# Backfill policies, partition mappings and partitioned checks are beta or preview in Dagster, which
# would warn at each load. The filters must precede the import of our assets.
warnings.filterwarnings("ignore", category=dg.BetaWarning)
warnings.filterwarnings("ignore", category=dg.PreviewWarning)

from oracle_pipeline.bags.terminal import escape_logs  # noqa: E402
from oracle_pipeline.programs import explain_clashes  # noqa: E402

with explain_clashes():
    from assets import (
        arrival_sensor,
        automation,
        evaluation_checks,
        experiment_runs,
        feature_dataset,
        foreign_recordings,
        oracle_evaluation,
        oracle_report,
        run_checks,
        thesis_method,
    )
    from resources.budget import StorageBudget
    from resources.bulk_commits import commit_in_bulk
    from resources.campaign import CampaignSettings
    from resources.fleet import Fleet
    from resources.inbox import Inbox
    from resources.no_values import NoValues
    from resources.run_executor import in_process_executor
    from resources.store import RunStore


def build_defs(**overrides: object) -> dg.Definitions:
    """Return the definitions, with some resources replaced.

    Parameters
    ----------
    **overrides
        Resources by name: ``store``, ``fleet``, ``campaign``, ``budget``, ``inbox``,
        ``io_manager``.

    Raises
    ------
    TypeError
        If a resource does not exist.
    """
    resources: dict[str, object] = {
        "store": RunStore(root=os.environ.get("ORACLE_HOME") or "data"),
        "fleet": Fleet(address=os.environ.get("ORACLE_DASK", "")),
        "campaign": CampaignSettings(),
        "budget": StorageBudget(limit=dg.EnvVar("ORACLE_STORAGE_BUDGET"))
        if "ORACLE_STORAGE_BUDGET" in os.environ
        else StorageBudget(),
        "inbox": Inbox.from_environment(),
        "io_manager": NoValues(),
    }
    if unknown := overrides.keys() - resources.keys():
        raise TypeError(f"There is no resource {sorted(unknown)}; there are {sorted(resources)}.")
    return dg.Definitions(
        assets=[
            *dg.load_assets_from_modules(
                [experiment_runs, feature_dataset, oracle_evaluation, thesis_method, oracle_report]
            ),
            *foreign_recordings.SPECS,
        ],
        asset_checks=[
            run_checks.checks_of_runs,
            evaluation_checks.checks_of_evaluation,
            foreign_recordings.checks_of_arrivals,
        ],
        jobs=[*automation.JOBS, foreign_recordings.judge_arrivals],
        schedules=[automation.nightly],
        sensors=[arrival_sensor.arrived_recordings],
        resources=resources | overrides,
        executor=in_process_executor,  # the assets fan out themselves
    )


escape_logs()
commit_in_bulk()
defs = build_defs()
