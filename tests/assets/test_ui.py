"""The real web server on the committed workspace shows what people look for."""

import json
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import uvicorn
from dagster_webserver.webserver import DagsterWebserver

from assets.evaluation_checks import CHECKS as OF_EVALUATION
from assets.experiment_runs import REPRODUCIBLE
from assets.foreign_recordings import IS_NORMAL
from assets.foreign_recordings import SPECS as ARRIVED
from assets.run_checks import CHECKS
from tests.assets.dagster_internals import WorkspaceFileTarget, WorkspaceProcessContext
from tests.assets.laboratory import ATTACKED, CONTROL, EVERYTHING, KEY, PER_RUN, ROOT, Laboratory

pytestmark = pytest.mark.slow

Query = Callable[[str], Any]


@pytest.fixture(scope="module")
def ui(campaign: Laboratory) -> Iterator[Query]:
    """A server on a free port of the loopback interface, asked in GraphQL as the browser does."""
    target = WorkspaceFileTarget(paths=[str(ROOT / "workspace.yaml")])
    with WorkspaceProcessContext(campaign.instance, target) as workspace:
        app = DagsterWebserver(workspace).create_asgi_app()
        server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="error"))
        thread = threading.Thread(target=server.run)
        thread.start()
        while not server.started:
            time.sleep(0.01)
        port = server.servers[0].sockets[0].getsockname()[1]

        def query(text: str) -> Any:
            request = urllib.request.Request(
                f"http://127.0.0.1:{port}/graphql",
                data=json.dumps({"query": text}).encode(),
                headers={"Content-Type": "application/json"},
            )
            with urllib.request.urlopen(request) as answer:  # noqa: S310
                document = json.load(answer)
            assert "errors" not in document, document
            return document["data"]

        yield query
        server.should_exit = True
        thread.join()


def test_the_ui_shows_every_asset_with_kinds_owners_and_partitions(ui: Query) -> None:
    nodes = ui(
        "{ assetNodes { assetKey { path } groupName kinds description isPartitioned"
        "  owners { ... on TeamAssetOwner { team } }"
        "  partitionKeysByDimension { name partitionKeys } } }"
    )["assetNodes"]
    arrived = {spec.key.path[0] for spec in ARRIVED}
    assert {node["assetKey"]["path"][0] for node in nodes} == {*EVERYTHING, *arrived}
    for node in nodes:
        assert node["kinds"], node
        assert node["owners"], node
        if node["isPartitioned"] and node["groupName"] != "foreign":
            mode, run = node["partitionKeysByDimension"]
            assert (mode["name"], run["name"]) == ("mode", "run")
            assert mode["partitionKeys"][:3] == [
                "lidar_passthrough",
                "lidar_passthrough_odom",
                "fake_object",
            ]
            assert run["partitionKeys"] == [f"run{i:03d}" for i in range(15)]


def test_the_ui_shows_automations_as_switched_off(ui: Query) -> None:
    repository = ui(
        "{ repositoriesOrError { ... on RepositoryConnection { nodes {"
        "  jobs { name } schedules { name scheduleState { status } }"
        "  sensors { name sensorState { status } } } } } }"
    )["repositoriesOrError"]["nodes"][0]
    assert {"everything", "judge_arrivals"} <= {job["name"] for job in repository["jobs"]}
    off = {"status": "STOPPED"}
    assert repository["schedules"] == [{"name": "nightly", "scheduleState": off}]
    assert {"name": "arrived_recordings", "sensorState": off} in repository["sensors"]


def test_the_matrix_shows_which_runs_exist(ui: Query) -> None:
    nodes = ui(
        "{ assetNodes { assetKey { path } assetPartitionStatuses { ... on MultiPartitionStatuses {"
        "  ranges { primaryDimStartKey primaryDimEndKey secondaryDim {"
        "  ... on DefaultPartitionStatuses { materializedPartitions failedPartitions } } } } } } }"
    )["assetNodes"]
    shown = {node["assetKey"]["path"][0]: node["assetPartitionStatuses"] for node in nodes}
    there = {"materializedPartitions": ["run000", "run001"], "failedPartitions": []}
    for asset in PER_RUN:
        assert shown[asset]["ranges"] == [
            {"primaryDimStartKey": mode, "primaryDimEndKey": mode, "secondaryDim": there}
            for mode in (CONTROL, ATTACKED)
        ]


@pytest.mark.parametrize("asset", EVERYTHING)
def test_nothing_is_stale_right_after_materialization(ui: Query, asset: str) -> None:
    partition = f'(partition: "{KEY}")' if asset in PER_RUN else ""
    (node,) = ui(
        f'{{ assetNodes(assetKeys: [{{path: ["{asset}"]}}]) {{'
        f"  staleStatus{partition} staleCauses{partition} {{ reason }} }} }}"
    )["assetNodes"]
    assert node == {"staleStatus": "FRESH", "staleCauses": []}


def test_a_report_shows_its_table(ui: Query) -> None:
    (node,) = ui(
        '{ assetNodes(assetKeys: [{path: ["clustering_grid_search"]}]) {'
        "  assetMaterializations(limit: 1) { metadataEntries { label"
        "  ... on TableMetadataEntry { table { records } }"
        "  } } } }"
    )["assetNodes"]
    (materialization,) = node["assetMaterializations"]
    entries = {entry["label"]: entry for entry in materialization["metadataEntries"]}
    assert json.loads(entries["table"]["table"]["records"][0])["linkage"] == "ward"


def test_each_check_shows_a_result_for_each_run(ui: Query) -> None:
    nodes = ui(
        "{ assetNodes { assetChecksOrError { ... on AssetChecks { checks { name partitionStatuses {"
        "  ... on AssetCheckMultiPartitionStatuses { ranges { primaryDimEndKey secondaryDim {"
        "  ... on AssetCheckDefaultPartitionStatuses { succeededPartitions } } } } } } } } } }"
    )["assetNodes"]
    checks = [check for node in nodes for check in node["assetChecksOrError"]["checks"]]
    of_runs = {each.name for each in CHECKS}
    others = {each.name for each in (*OF_EVALUATION, REPRODUCIBLE, IS_NORMAL)}
    assert {c["name"] for c in checks} == of_runs | others
    for check in (check for check in checks if check["name"] in of_runs):
        last = check["partitionStatuses"]["ranges"][-1]
        assert last["primaryDimEndKey"] == ATTACKED
        assert last["secondaryDim"]["succeededPartitions"] == ["run000", "run001"]
