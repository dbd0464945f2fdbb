"""The sensor that re-simulates the runs of modes whose scenario file has changed.

It reads the files at every tick, unlike the modes, which are read when the code location loads.
"""

import itertools
import json
import os
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import dagster as dg

from assets.automation import everything, refreshed_runs
from assets.experiment_runs import EXPERIMENT_RUNS
from assets.partitions import RUNS, chosen_modes
from sim.fuzzing.compilation import compile_file
from sim.fuzzing.scenario import Scenario, ScenarioError
from sim.modes import broken_scenarios, modes

NO_CHANGE = (
    "No mode's scenario has changed. A new scenario becomes a mode, and its runs partitions, when "
    "the code location is reloaded."
)


@dg.sensor(
    job=everything,
    minimum_interval_seconds=60,
    default_status=dg.DefaultSensorStatus.STOPPED,
    description="When the scenario file of a mode changes: re-simulate its materialized runs, and "
    "update the report.",
)
def changed_scenarios(context: dg.SensorEvaluationContext) -> dg.SensorResult:
    """Compare each mode's scenario with the last tick, and request stale runs."""
    previous: dict[str, str] = json.loads(context.cursor or "{}")
    now, broken = _digests()
    changed = {mode: now[mode] for mode in now if previous.get(mode, now[mode]) != now[mode]}
    cursor = json.dumps(previous | now)
    requests = list(_requests(context.instance, changed))
    if requests:
        return dg.SensorResult(run_requests=requests, cursor=cursor)
    reasons = [f"{mode} has changed, but has no materialized run." for mode in changed]
    reasons += [f"Left out: {wrong}" for wrong in broken]
    return dg.SensorResult(skip_reason=" ".join(reasons) or NO_CHANGE, cursor=cursor)


def _digests() -> tuple[dict[str, str], list[str]]:
    """Return the current digest of each mode's scenario, and the faults in files."""
    names: defaultdict[str, list[str]] = defaultdict(list)
    for mode in chosen_modes(os.environ):
        names[modes()[mode].scenario.file].append(mode)
    digests: dict[str, str] = {}
    faults = list(broken_scenarios())
    for file, of_file in names.items():
        try:
            scenarios = _scenarios(Path(file))
        except ScenarioError as error:
            faults.append(str(error))
            continue
        digests |= {name: scenarios[name].digest for name in of_file if name in scenarios}
        faults += [f"{file} has no {name} any more." for name in of_file if name not in scenarios]
    return digests, faults


def _scenarios(file: Path) -> dict[str, Scenario]:
    """Return the scenarios of a file by name, with their shadow controls."""
    scenarios: dict[str, Scenario] = {}
    for scenario in (program.scenario for program in compile_file(file)):
        shadow = scenario.as_shadow()
        scenarios = {shadow.id: shadow} | scenarios | {scenario.id: scenario}
    return scenarios


def _requests(instance: dg.DagsterInstance, changed: Mapping[str, str]) -> Iterator[dg.RunRequest]:
    """Request each range of a changed mode's materialized runs, once for each change."""
    if not changed:
        return
    materialized = instance.get_materialized_partitions(EXPERIMENT_RUNS.key)
    latest = instance.get_latest_materialization_event(EXPERIMENT_RUNS.key)
    after = (
        latest.timestamp if latest else 0.0
    )  # in the run key, so that changing back requests the runs again
    for mode, digest in changed.items():
        for first, last in _ranges(mode, materialized):
            yield refreshed_runs(first, last, run_key=f"{first}...{last} {digest} {after}")


def _ranges(mode: str, keys: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield the first and last key of each contiguous range of a mode's runs among the keys."""
    runs = RUNS.get_partitions_def_for_dimension("run").get_partition_keys()
    of_mode = [f"{mode}|{run}" for run in runs]
    for is_included, group in itertools.groupby(of_mode, lambda key: key in keys):
        if is_included:
            consecutive = list(group)
            yield consecutive[0], consecutive[-1]
