"""The UI executes runs again that were started on the command line."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import requests

from tests.instances import instance_of, make_home
from tests.servers import ROOT, answers, environment, free_port, process, wait_until

pytestmark = pytest.mark.slow(10)

AGAIN = """mutation($run: String!) {
  launchPipelineReexecution(reexecutionParams: {parentRunId: $run, strategy: ALL_STEPS}) {
    __typename
    ... on LaunchRunSuccess { run { runId } }
    ... on PythonError { message }
  }
}"""


def test_a_run_of_the_command_line_can_be_executed_again(tmp_path: Path) -> None:
    """Dagster itself records no code location of such a run, and answers with an error 500."""
    home, log, port = make_home(tmp_path / "home"), tmp_path / "log", free_port()
    shutil.copy(ROOT / "workspace.yaml", tmp_path)
    subprocess.run(
        [sys.executable, "-m", "dagster", "asset", "materialize",
         "-m", "oracle_pipeline.definitions", "--select", "feature_dataset"],
        cwd=tmp_path, env=environment(DAGSTER_HOME=str(home)), check=False, capture_output=True,
    )  # fmt: skip
    command = ["assets.webserver", "--webserver-only", "-w", "workspace.yaml", "-p", port]
    with process(command, log, {"DAGSTER_HOME": str(home)}), instance_of(home) as instance:
        (first,) = instance.get_runs()
        wait_until(lambda: answers(int(port)), log, 240)
        answer = requests.post(
            f"http://127.0.0.1:{port}/graphql",
            json={"query": AGAIN, "variables": {"run": first.run_id}},
            timeout=240,
        )
        launched = answer.json()["data"]["launchPipelineReexecution"]
        assert launched["__typename"] == "LaunchRunSuccess", launched
        again = instance.get_run_by_id(launched["run"]["runId"])
        assert again is not None
        assert (again.job_name, again.parent_run_id) == (first.job_name, first.run_id)
        assert again.asset_selection == first.asset_selection
