"""The report opens from the UI, and its content cannot use the UI."""

import pytest
import requests

from assets.webserver.metrics import METRICS_PATH
from assets.webserver.report import REPORT_PATH
from oracle_pipeline.scoring.kept_verdicts import KeptVerdict, add_verdicts
from oracle_pipeline.scoring.verdict import Verdict
from tests.ui import web_server

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("root")
    (root / "report" / "runs").mkdir(parents=True)
    (root / "report" / "index.html").write_text("<script>alert(1)</script>the report")
    (root / "report" / "runs" / "one.html").write_text("one run")
    verdict = KeptVerdict("a", "", Verdict("a", "anomalous"), 0.05, "", "2026-11-28T00:00:00")
    add_verdicts(root, [verdict])
    (root / "secret.txt").write_text("secret")
    (root / "report" / "link").symlink_to(root / "secret.txt")
    return root


@pytest.fixture(scope="module")
def server(root, tmp_path_factory):
    with web_server(tmp_path_factory.mktemp("ui"), ORACLE_HOME=str(root)) as started:
        yield started


def get(server, path, **headers):
    answer = requests.get(f"{server.origin}{REPORT_PATH}{path}", headers=headers, timeout=30)
    return answer.status_code, answer.text, answer.headers


@pytest.mark.parametrize(("path", "text"), [("/", "the report"), ("/runs/one.html", "one run")])
def test_pages_are_served_with_scripts_forbidden(server, path, text):
    status, page, headers = get(server, path)
    assert (status, text in page) == (200, True)
    assert "sandbox; default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    "path", ["/%2e%2e/secret.txt", "/..%2fsecret.txt", "/link", "/runs/", "/absent.html"]
)
def test_nothing_outside_the_report_is_served(server, path):
    status, page, _ = get(server, path)
    assert status == 404 or "<title>Dagster" in page  # a path that was shortened on its way
    assert "secret" not in page


def test_the_guard_protects_the_report(server):
    assert get(server, "/", Host="evil.example")[0] == 403


def test_prometheus_reads_runs_verdicts_and_free_space(server):
    answer = requests.get(f"{server.origin}{METRICS_PATH}", timeout=30)
    assert answer.headers["Content-Type"].startswith("text/plain")
    figures = dict(line.rsplit(" ", 1) for line in answer.text.splitlines() if line[0] != "#")
    assert figures['oracle_dagster_runs{status="QUEUED"}'] == "0"
    assert figures['oracle_partitions{asset="experiment_runs"}'] == "0"
    assert figures['oracle_verdicts{outcome="anomalous"}'] == "1"
    assert int(figures['oracle_free_bytes{root=""}']) > 0


def test_without_a_report_dagsters_pages_still_work(tmp_path):
    with web_server(tmp_path, ORACLE_HOME=str(tmp_path / "none")) as started:
        assert get(started, "/")[0] == 404
        assert started.runs() == 0
