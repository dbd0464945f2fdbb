"""The web server as `oracle-ui` starts it, on definitions with one job that does nothing."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import dagster as dg

from tests.servers import ROOT, answers, free_port, process, wait_until

LAUNCH = """mutation {
  launchRun(executionParams: {runConfigData: "{}", selector: {
    repositoryLocationName: "here", repositoryName: "__repository__", jobName: "nothing"
  }}) { __typename }
}"""
DEFINITIONS = """
import dagster as dg

@dg.op
def nothing_to_do():
    pass

@dg.job(executor_def=dg.in_process_executor)
def nothing():
    nothing_to_do()

defs = dg.Definitions(jobs=[nothing])
"""
WORKSPACE = "load_from: [{python_file: {relative_path: nothing.py, location_name: here}}]"


@dataclass
class WebServer:
    """A web server that listens on loopback, and the instance whose runs it starts."""

    port: int
    instance: dg.DagsterInstance

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def runs(self) -> int:
        return self.instance.get_runs_count()


@contextmanager
def web_server(folder: Path, **variables: str) -> Iterator[WebServer]:
    """Start the web server in a folder of its own."""
    home, log, port = folder / "home", folder / "log", free_port()
    home.mkdir()
    shutil.copy(ROOT / ".dagster_home" / "dagster.yaml", home)
    (folder / "nothing.py").write_text(DEFINITIONS)
    (folder / "workspace.yaml").write_text(WORKSPACE)
    command = ["resources.ui", "--webserver-only", "-p", port]
    with (
        process(command, log, {"DAGSTER_HOME": str(home), **variables}),
        dg.DagsterInstance.from_config(str(home)) as instance,
    ):
        wait_until(lambda: answers(int(port)), log)
        yield WebServer(int(port), instance)
