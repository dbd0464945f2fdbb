"""What deploy/ must not contain: known passwords, the root account, unknown files, open ports."""

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.servers import ROOT

DEPLOY = ROOT / "deploy"
FILES = sorted(path for path in DEPLOY.rglob("*") if path.is_file() and path.suffix != ".txt")
SECRET = re.compile(r"PASSWORD|SECRET|TOKEN|ACCESS_KEY", re.IGNORECASE)


def documents(name: str) -> list[dict[str, Any]]:
    return list(yaml.safe_load_all((DEPLOY / name).read_text(encoding="utf-8")))


def settings(node: object, name: str = "") -> Iterator[tuple[str, object]]:
    """Yield the names and values of a document, at any depth."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from settings(value, str(key))
        if "name" in node and "value" in node:
            yield str(node["name"]), node["value"]
    elif isinstance(node, list):
        for each in node:
            yield from settings(each, name)
    else:
        yield name, node


SERVICES: dict[str, Any] = documents("compose.yaml")[0]["services"]


@pytest.mark.parametrize("file", [f for f in FILES if f.suffix == ".yaml"], ids=lambda f: f.name)
def test_no_secret_has_a_value_or_a_default(file: Path) -> None:
    for document in documents(str(file.relative_to(DEPLOY))):
        for name, value in settings(document):
            if SECRET.search(name) and isinstance(value, str) and "Secret" not in name:
                asked = re.fullmatch(r"\$\{\w+:\?\}|postgresql-password", value)
                assert asked or name.endswith("_FILE"), f"{file.name}: {name} is {value!r}"


def test_the_root_account_of_the_store_stays_with_the_store() -> None:
    for name, service in SERVICES.items():
        names = set(service["environment"]) & {"MINIO_ROOT_PASSWORD", "MINIO_ROOT_USER"}
        assert not names or name in {"s3", "s3-user"}
    assert "ORACLE_S3_ROOT_PASSWORD" not in json.dumps(
        {name: SERVICES[name] for name in SERVICES.keys() - {"s3", "s3-user"}}
    )


def test_the_user_of_the_store_reaches_one_bucket_and_nothing_else() -> None:
    policy = json.loads((DEPLOY / "s3-policy.json").read_text(encoding="utf-8"))
    for statement in policy["Statement"]:
        assert statement["Effect"] == "Allow"
        assert not [action for action in statement["Action"] if "*" in action]
        for resource in statement["Resource"]:
            assert resource.removesuffix("/*") == "arn:aws:s3:::oracle"
    bucket = SERVICES["code"]["environment"]["ORACLE_HOME"].split("/")[2]
    assert bucket == "oracle"
    assert "s3-policy.json" in json.dumps(SERVICES["s3-user"])


@pytest.mark.parametrize("service", SERVICES.values(), ids=SERVICES)
def test_a_container_gains_no_privileges(service: dict[str, Any]) -> None:
    assert "no-new-privileges:true" in service["security_opt"]
    assert service["pids_limit"]
    assert not service.get("privileged")


def test_the_image_takes_only_files_whose_hash_is_known() -> None:
    text = (DEPLOY / "Containerfile").read_text(encoding="utf-8")
    installs = [line for line in text.splitlines() if line.startswith("RUN pip install")]
    assert len(installs) == 2
    assert "--require-hashes" in installs[0]
    assert all(word in installs[1] for word in ("--no-deps", "--no-index", "--no-build-isolation"))
    assert re.search(r"^USER \d+$", text, re.MULTILINE)
    planned = subprocess.run(
        ["make", "--dry-run", "image"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    pinned, built = planned.index("--constraint constraints.txt"), planned.index("docker build")
    assert pinned < planned.index("--output-file deploy/requirements.txt") < built
    assert "--generate-hashes" in planned
    assert "deploy/requirements.txt" in (ROOT / ".gitignore").read_text(encoding="utf-8")


def test_every_image_of_others_carries_a_tag_that_does_not_move() -> None:
    for name, service in SERVICES.items():
        default = re.sub(r"^\$\{\w+:-(.*)\}$", r"\1", service["image"])
        assert default == "ros2-behaviour-oracle" or re.search(r":[\w.-]*\d", default), name


def pods() -> Iterator[tuple[str, dict[str, Any], dict[str, Any], dict[str, Any]]]:
    """Yield name, pod context, container context and resources of all that Kubernetes starts."""
    (values,) = documents("kubernetes/dagster.yaml")
    for part in (values["dagsterDaemon"], *values["dagster-user-deployments"]["deployments"]):
        name = part.get("name", "daemon")
        yield name, part["podSecurityContext"], part["securityContext"], part["resources"]
    for file in ("kubernetes/dask.yaml", "kubernetes/ui.yaml"):
        for document in documents(file):
            if document["kind"] == "Deployment":
                spec = document["spec"]["template"]["spec"]
                for container in (*spec.get("initContainers", ()), *spec["containers"]):
                    yield (container["name"], spec["securityContext"],
                           container["securityContext"], container["resources"])  # fmt: skip


@pytest.mark.parametrize(("name", "pod", "container", "resources"), list(pods()))
def test_a_pod_is_no_root_and_has_limits(
    name: str, pod: dict[str, Any], container: dict[str, Any], resources: dict[str, Any]
) -> None:
    assert pod["runAsNonRoot"]
    assert pod["seccompProfile"] == {"type": "RuntimeDefault"}
    assert container["allowPrivilegeEscalation"] is False
    assert container["capabilities"] == {"drop": ["ALL"]}
    assert resources["limits"].keys() == {"cpu", "memory"}


def test_only_the_guarded_web_server_is_started() -> None:
    assert SERVICES["webserver"]["command"].startswith("oracle-ui ")
    (values,) = documents("kubernetes/dagster.yaml")
    assert values["dagsterWebserver"]["replicaCount"] == 0
    arguments = json.dumps(documents("kubernetes/ui.yaml"))
    assert '"oracle-ui"' in arguments
    everything = "".join(path.read_text(encoding="utf-8") for path in FILES)
    assert "dagster-webserver" not in everything
    assert "dagster dev" not in everything
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(r"^ui:.*\n\toracle-ui ", makefile, re.MULTILINE)
