"""How long people wait for Dagster with a thousand runs of each of the six modes.

The records are created without simulating any runs, because only Dagster is timed. The instance is
that of a workstation, on SQLite.
"""

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tools.bench.figures import Row, median, spread
from tools.soak.budget import FIRST, LAST

ROOT = Path(__file__).parents[2]
RUNS = 1000  # of each mode
AT_ONCE = (50, 250)  # partitions in a range
ROUNDS = 5
RESPONSIVE_S = 2.0
QUERIES = {
    "all assets, how many partitions each has": (
        "{ assetNodes { assetKey { path } partitionStats { numPartitions numMaterialized } } }"
    ),
    "one asset, which partitions exist": (
        '{ assetNodes(assetKeys: [{path: ["experiment_runs"]}]) {'
        "  partitionKeysByDimension { name partitionKeys }"
        "  assetPartitionStatuses { ... on MultiPartitionStatuses { ranges { primaryDimStartKey"
        "  secondaryDim { ... on DefaultPartitionStatuses { materializedPartitions } } } } } } }"
    ),
    "one run, its latest materialization": (
        '{ assetNodes(assetKeys: [{path: ["experiment_runs"]}]) {'
        f'  assetMaterializations(partitions: ["{FIRST}|run000"], limit: 1) {{'
        "  timestamp metadataEntries { label } } } }"
    ),
}
_CALL = "import sys, tools.bench.instance as b; getattr(b, sys.argv[1])(*sys.argv[2:])"


def rows() -> Iterator[Row]:
    """Yield the figures."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        shutil.copy(ROOT / ".dagster_home" / "dagster.yaml", home)
        os.environ |= {"DAGSTER_HOME": folder, "ORACLE_RUNS": str(RUNS)}
        runs = int(_in_a_process("materialize", folder))
        for number in AT_ONCE:
            planned_s = float(_in_a_process("plan", folder, str(number)))
            yield Row(f"a range of {number} partitions, until it starts", planned_s, "s")
        with _webserver(home) as url:
            for name, query in QUERIES.items():
                waits = [_answered_in_s(url, query) for _ in range(ROUNDS)]
                yield Row(f"{runs} runs in the UI: {name}", median(waits), "s", RESPONSIVE_S, True,
                          spread(waits))  # fmt: skip


def _in_a_process(function: str, *arguments: str) -> str:
    command = [sys.executable, "-W", "ignore", "-c", _CALL, function, *arguments]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return done.stdout.splitlines()[-1]


def materialize(home: str) -> None:
    """Report all runs of six modes as materialized, and print how many there are."""
    import dagster as dg

    keys = _keys()
    with dg.DagsterInstance.from_config(home) as instance:
        for key in keys:
            instance.report_runless_asset_event(
                dg.AssetMaterialization("experiment_runs", partition=key, metadata={"goals": 8})
            )
    print(len(keys))


def plan(home: str, number: str) -> None:
    """Create a Dagster run over all assets and a range of partitions; print how long it took."""
    import dagster as dg

    from oracle_pipeline.definitions import defs

    keys = _keys()[: int(number)]
    job = defs.resolve_implicit_global_asset_job_def()
    # As the command does: without the checks of external assets, whose partitions are others.
    job = job.get_subset(asset_selection=job.asset_layer.selected_asset_keys)
    with dg.DagsterInstance.from_config(home) as instance:
        started = time.perf_counter()
        instance.create_run_for_job(
            job_def=job,
            tags={
                "dagster/asset_partition_range_start": keys[0],
                "dagster/asset_partition_range_end": keys[-1],
            },
        )
        print(time.perf_counter() - started)


def _keys() -> list[str]:
    """Return the keys of all runs of the six modes, mode by mode."""
    import dagster as dg

    from assets.partitions import RUNS as PARTITIONS

    between = dg.PartitionKeyRange(f"{FIRST}|run000", f"{LAST}|run{RUNS - 1:03d}")
    return list(PARTITIONS.get_partition_keys_in_range(between))


@contextmanager
def _webserver(home: Path) -> Iterator[str]:
    """Start the web server that `dagster dev` starts, and wait until it answers."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = ["dagster-webserver", "-w", str(ROOT / "workspace.yaml"), "-h", "127.0.0.1"]
    with (home / "log").open("wb") as log:
        server = subprocess.Popen([*command, "-p", str(port)], cwd=home, stdout=log, stderr=log)
    url = f"http://127.0.0.1:{port}/graphql"
    try:
        while True:
            try:
                _answered_in_s(url, "{ version }")
                break
            except urllib.error.URLError:
                if server.poll() is not None:
                    raise RuntimeError((home / "log").read_text()) from None
                time.sleep(0.2)
        yield url
    finally:
        server.terminate()
        server.wait()


def _answered_in_s(url: str, query: str) -> float:
    body = json.dumps({"query": query}).encode()
    request = urllib.request.Request(url, body, {"Content-Type": "application/json"})  # noqa: S310
    started = time.perf_counter()
    with urllib.request.urlopen(request) as answer:  # noqa: S310 -- our own server
        document: dict[str, Any] = json.load(answer)
    if "errors" in document:
        raise RuntimeError(str(document["errors"]))
    return time.perf_counter() - started
