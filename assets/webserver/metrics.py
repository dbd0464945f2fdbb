"""Figures on the pipeline for Prometheus, in its text format.

The rate of ``oracle_partitions`` of experiment runs is that of simulated runs.
"""

import shutil
from collections import Counter
from collections.abc import Iterator, Mapping

import dagster as dg
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.routing import Route

from resources.store import RunStore

METRICS_PATH = "/oracle/metrics"
_ASSETS = ("experiment_runs", "run_features", "foreign_verdicts")


def metrics_route(instance: dg.DagsterInstance, store: RunStore) -> Route:
    """Return the route that serves the figures."""

    def answer(_request: Request) -> PlainTextResponse:
        return PlainTextResponse("".join(_lines(instance, store)))

    return Route(METRICS_PATH, answer)


def _lines(instance: dg.DagsterInstance, store: RunStore) -> Iterator[str]:
    from oracle_pipeline.scoring.kept_verdicts import verdict_rows

    runs = {
        status.value: instance.get_runs_count(dg.RunsFilter(statuses=[status]))
        for status in dg.DagsterRunStatus
    }
    made = {a: len(instance.get_materialized_partitions(dg.AssetKey(a))) for a in _ASSETS}
    yield from _gauge("oracle_dagster_runs", "status", runs)
    yield from _gauge("oracle_partitions", "asset", made)
    verdicts = Counter(verdict_rows(store.path)["outcome"])
    yield from _gauge("oracle_verdicts", "outcome", verdicts)
    if store.is_local and store.path.is_dir():
        yield from _gauge("oracle_free_bytes", "root", {"": shutil.disk_usage(store.path).free})


def _gauge(name: str, label: str, values: Mapping[str, int]) -> Iterator[str]:
    yield f"# TYPE {name} gauge\n"
    for value, number in values.items():
        yield f'{name}{{{label}="{value}"}} {number}\n'
