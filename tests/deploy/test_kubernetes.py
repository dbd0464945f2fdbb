"""The example for Kubernetes fits its models, the launcher of Dagster, and the image."""

import re
from typing import Any

import dagster as dg
import pytest
from dagster_k8s import K8sRunLauncher
from dagster_k8s.models import k8s_model_from_dict, k8s_snake_case_dict
from kubernetes import client

from tests.deploy.test_hardening import DEPLOY, documents

MODELS = {
    "Deployment": client.V1Deployment,
    "NetworkPolicy": client.V1NetworkPolicy,
    "PodDisruptionBudget": client.V1PodDisruptionBudget,
    "Service": client.V1Service,
}
MANIFESTS = [each for file in ("dask", "ui") for each in documents(f"kubernetes/{file}.yaml")]
(VALUES,) = documents("kubernetes/dagster.yaml")


def name(manifest: dict[str, Any]) -> str:
    return f"{manifest['kind']} {manifest['metadata']['name']}"


def deployments() -> list[dict[str, Any]]:
    return [each for each in MANIFESTS if each["kind"] == "Deployment"]


@pytest.mark.parametrize("manifest", MANIFESTS, ids=name)
def test_a_manifest_has_what_its_kind_needs_and_nothing_unknown(manifest: dict[str, Any]) -> None:
    model = MODELS[manifest["kind"]]
    k8s_model_from_dict(model, k8s_snake_case_dict(model, manifest))


def test_an_unknown_field_of_a_manifest_is_found() -> None:
    manifest = {**deployments()[0], "spce": {}}
    with pytest.raises(Exception, match="spce"):
        k8s_snake_case_dict(client.V1Deployment, manifest)


@pytest.mark.parametrize("manifest", MANIFESTS, ids=name)
def test_what_selects_pods_selects_those_of_a_deployment(manifest: dict[str, Any]) -> None:
    spec = manifest["spec"]
    selector = spec.get("selector") or spec["podSelector"]
    wanted = selector.get("matchLabels", selector).items()
    labels = [each["spec"]["template"]["metadata"]["labels"] for each in deployments()]
    assert any(wanted <= each.items() for each in labels)


@pytest.mark.parametrize("deployment", deployments(), ids=name)
def test_each_mounted_volume_exists_and_a_server_is_probed(deployment: dict[str, Any]) -> None:
    pod = deployment["spec"]["template"]["spec"]
    volumes = {volume["name"] for volume in pod.get("volumes", ())}
    for container in (*pod.get("initContainers", ()), *pod["containers"]):
        assert {mount["name"] for mount in container.get("volumeMounts", ())} <= volumes
    if deployment["metadata"]["name"] != "oracle-dask-worker":  # it has no port
        assert {"readinessProbe", "livenessProbe"} <= pod["containers"][0].keys()


def test_each_run_is_a_pod_that_the_launcher_of_dagster_accepts() -> None:
    values = VALUES["runLauncher"]
    assert values["type"] == "K8sRunLauncher"
    given = values["config"]["k8sRunLauncher"]
    of_runs = {snake(key): value for key, value in given["runK8sConfig"].items()}
    config = {  # as the template of the chart makes it
        "load_incluster_config": given["loadInclusterConfig"],
        "image_pull_policy": given["imagePullPolicy"],
        "fail_pod_on_run_failure": given["failPodOnRunFailure"],
        "service_account_name": "dagster",
        "dagster_home": "/opt/dagster/dagster_home",
        "instance_config_map": "oracle-dagster-instance",
        "run_k8s_config": of_runs,
    }

    @dg.op(config_schema=K8sRunLauncher.config_type())
    def launch() -> None: ...

    @dg.job
    def runs() -> None:
        launch()

    assert dg.validate_run_config(runs, {"ops": {"launch": {"config": config}}})
    for part, model in (
        ("podSpecConfig", client.V1PodSpec),
        ("containerConfig", client.V1Container),
        ("jobSpecConfig", client.V1JobSpec),
    ):
        k8s_snake_case_dict(model, given["runK8sConfig"][part])
    (code,) = VALUES["dagster-user-deployments"]["deployments"]
    assert code["includeConfigInLaunchedRuns"]["enabled"]


def snake(key: str) -> str:
    return re.sub("([A-Z])", lambda found: f"_{found[1].lower()}", key)


def test_workers_start_with_the_loops_that_the_image_has_compiled() -> None:
    image = (DEPLOY / "Containerfile").read_text(encoding="utf-8")
    (folder,) = re.findall(r"NUMBA_CACHE_DIR=(\S+)", image)
    assert "RUN python tools/scripts/compile_loops.py" in image
    assert "NUMBA_CPU_NAME=generic" in image  # the machine that builds is not the one that runs
    (workers,) = (each for each in deployments() if "worker" in each["metadata"]["name"])
    pod = workers["spec"]["template"]["spec"]
    (copies,), (worker,) = pod["initContainers"], pod["containers"]
    (mount,) = copies["volumeMounts"]
    assert copies["command"] == ["cp", "-a", f"{folder}/.", mount["mountPath"]]
    assert {"name": mount["name"], "mountPath": folder} in worker["volumeMounts"]
