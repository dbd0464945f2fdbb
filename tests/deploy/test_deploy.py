"""The deployment's files: they load, they agree, and their processes start together."""

import json
import os
import re
import shutil
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest import mock

import dagster as dg
import pytest
import yaml

from tests.servers import ROOT, answers, free_port, postgres_server, process, wait_until

pytestmark = pytest.mark.slow

DEPLOY = ROOT / "deploy"


@pytest.fixture(scope="module")
def variables() -> Iterator[dict[str, str]]:
    """What compose.yaml would set, for servers on loopback."""
    with postgres_server() as postgres:
        code = {"ORACLE_CODE_HOST": "127.0.0.1", "ORACLE_CODE_PORT": free_port()}
        with mock.patch.dict(os.environ, postgres | code):
            yield postgres | code


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("home")
    shutil.copy(DEPLOY / "dagster.yaml", folder)
    return folder


def documents(name: str) -> list[dict[str, Any]]:
    return list(yaml.safe_load_all((DEPLOY / name).read_text(encoding="utf-8")))


def test_the_instance_keeps_runs_and_partitions_in_postgresql(
    variables: dict[str, str], home: Path
) -> None:
    @dg.asset(partitions_def=dg.StaticPartitionsDefinition(["a", "b"]))
    def one() -> dg.MaterializeResult[None]:
        return dg.MaterializeResult(data_version=dg.DataVersion("1"), metadata={"figure": 3})

    with dg.DagsterInstance.from_config(str(home)) as instance:
        assert dg.materialize([one], partition_key="b", instance=instance).success
    with dg.DagsterInstance.from_config(str(home)) as later:
        assert later.get_materialized_partitions(dg.AssetKey("one")) == {"b"}
        event = later.get_latest_materialization_event(dg.AssetKey("one"))
        assert event is not None
        assert event.asset_materialization is not None
        assert event.asset_materialization.metadata["figure"].value == 3
        assert later.is_persistent
        assert "Postgres" in type(later.event_log_storage).__name__
    assert sorted(path.suffix for path in home.rglob("*.db")) == []


def test_an_instance_differs_from_that_of_a_workstation_in_its_storage_only() -> None:
    workstation = yaml.safe_load((ROOT / ".dagster_home/dagster.yaml").read_text(encoding="utf-8"))
    (deployed,) = documents("dagster.yaml")
    assert deployed.pop("storage")["postgres"]["postgres_db"]["scheme"] == "postgresql+psycopg2"
    assert deployed == workstation


def test_code_location_webserver_and_daemon_start_together(
    variables: dict[str, str], home: Path
) -> None:
    port, workspace = free_port(), str(DEPLOY / "workspace.yaml")
    set_there = {"DAGSTER_HOME": str(home)}
    logs = {name: home / f"{name}.log" for name in ("code", "webserver", "daemon")}
    with ExitStack() as processes:
        for name, command in (
            ("code", ["dagster", "code-server", "start", "-h", "127.0.0.1",
                      "-p", variables["ORACLE_CODE_PORT"], "-m", "oracle_pipeline.definitions"]),
            ("webserver", ["assets.webserver", "--webserver-only", "-h", "127.0.0.1", "-p", port,
                           "-w", workspace]),
            ("daemon", ["dagster._daemon", "run", "-w", workspace]),
        ):  # fmt: skip
            if name == "webserver":
                wait_until(lambda: answers(int(variables["ORACLE_CODE_PORT"])), logs["code"])
            processes.enter_context(process(command, logs[name], set_there))
        wait_until(lambda: answers(int(port)), logs["webserver"])
        wait_until(lambda: "oracle_report" in assets(port), logs["webserver"])
        with dg.DagsterInstance.from_config(str(home)) as instance:
            wait_until(lambda: "QUEUED_RUN_COORDINATOR" in instance.get_daemon_heartbeats(),
                       logs["daemon"])  # fmt: skip


def assets(port: str) -> set[str]:
    """The assets that the webserver shows."""
    query = json.dumps({"query": "{assetNodes {assetKey {path}}}"}).encode()
    request = urllib.request.Request(
        f"http://127.0.0.1:{port}/graphql", query, {"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request, timeout=60) as answer:  # noqa: S310
        nodes = json.load(answer)["data"]["assetNodes"]
    return {"/".join(node["assetKey"]["path"]) for node in nodes}


def test_compose_gives_every_variable_that_the_files_ask_for() -> None:
    (compose,) = documents("compose.yaml")
    given = compose["services"]["code"]["environment"]
    asked = set()
    for name in ("dagster.yaml", "workspace.yaml"):
        asked |= set(re.findall(r"env: (\w+)", (DEPLOY / name).read_text(encoding="utf-8")))
    assert asked
    assert asked <= given.keys()
    for name, service in compose["services"].items():
        assert service.keys() >= {"image"}, name
        for needed in service.get("depends_on", {}):
            assert needed in compose["services"]
    assert given["ORACLE_DASK"] == "tcp://scheduler:8786"
    assert f"dask worker {given['ORACLE_DASK']}" in compose["services"]["worker"]["command"]


def test_ports_are_open_to_this_machine_only() -> None:
    (compose,) = documents("compose.yaml")
    ports = [port for service in compose["services"].values() for port in service.get("ports", ())]
    assert ports == ["127.0.0.1:3000:3000"]


def test_the_image_holds_what_the_distribution_holds() -> None:
    text = (DEPLOY / "Containerfile").read_text(encoding="utf-8")
    copied = set(re.findall(r"^COPY (\w+) \1$", text, flags=re.MULTILINE))
    assert copied == {"oracle_pipeline", "assets", "resources", "sim"}
    named = set(re.findall(r"deploy/[\w.]+", text)) - {"deploy/requirements.txt"}  # made before it
    assert all((ROOT / name).exists() for name in named)


def test_kubernetes_names_the_cluster_that_it_starts() -> None:
    (values,) = documents("kubernetes/dagster.yaml")
    (deployment,) = values["dagster-user-deployments"]["deployments"]
    services = {d["metadata"]["name"] for d in documents("kubernetes/dask.yaml")
                if d["kind"] == "Service"}  # fmt: skip
    assert deployment["env"]["ORACLE_DASK"] in {f"tcp://{name}:8786" for name in services}
    workers = next(d for d in documents("kubernetes/dask.yaml")
                   if d["kind"] == "Deployment"
                   and d["metadata"]["name"] == "oracle-dask-worker")  # fmt: skip
    (container,) = workers["spec"]["template"]["spec"]["containers"]
    assert deployment["env"]["ORACLE_DASK"] in container["args"]
    variables = {variable["name"]: variable["value"] for variable in container["env"]}
    assert variables["ORACLE_HOME"] == deployment["env"]["ORACLE_HOME"]
