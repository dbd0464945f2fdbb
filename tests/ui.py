"""What `oracle-ui` starts: its web server alone, or all of it on the real pipeline."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import dagster as dg

from tests.instances import instance_of, make_home
from tests.servers import answers, end_with_parent, environment, free_port, process, wait_until

LAUNCH = """mutation {
  launchRun(executionParams: {runConfigData: "{}", selector: {
    repositoryLocationName: "here", repositoryName: "__repository__", jobName: "nothing"
  }}) { __typename }
}"""
NOTHING = """
import dagster as dg

@dg.op
def nothing_to_do():
    pass

@dg.job(executor_def=dg.in_process_executor)
def nothing():
    nothing_to_do()

defs = dg.Definitions(jobs=[nothing])
"""
WORKSPACE = "load_from: [{python_file: {relative_path: definitions.py, location_name: here}}]"

# The pipeline, and a schedule whose next tick is at most a minute away.
PIPELINE = """
import dagster as dg
from oracle_pipeline.definitions import build_defs

@dg.op
def nothing_to_do():
    pass

@dg.job
def nothing():
    nothing_to_do()

every_minute = dg.ScheduleDefinition(name="every_minute", job=nothing, cron_schedule="* * * * *")
defs = dg.Definitions.merge(build_defs(), dg.Definitions(schedules=[every_minute]))
"""
STARTS_S, ENDS_S = 240, 120  # in which servers and daemon start, and end in order


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
    """Start the web server in a separate folder, on a job that does nothing."""
    home, log, port = _instance(folder, NOTHING), folder / "log", free_port()
    command = ["assets.webserver", "--webserver-only", "-p", port]
    with (
        process(command, log, {"DAGSTER_HOME": str(home), **variables}),
        instance_of(home) as instance,
    ):
        wait_until(lambda: answers(int(port)), log)
        yield WebServer(int(port), instance)


@contextmanager
def pipeline_ui(folder: Path, **variables: str) -> Iterator[WebServer]:
    """Start server, daemon and code server on the pipeline, in a separate folder."""
    home, log, port = _instance(folder, PIPELINE), folder / "log", free_port()
    command = [sys.executable, "-m", "assets.webserver", "-p", port]
    with (
        log.open("wb") as output,
        subprocess.Popen(
            command,
            cwd=folder,
            env=environment(DAGSTER_HOME=str(home), **variables),
            stdout=output,
            stderr=subprocess.STDOUT,
            preexec_fn=end_with_parent(),
        ) as server,
        instance_of(home) as instance,
    ):
        try:
            wait_until(lambda: answers(int(port)), log, STARTS_S)
            yield WebServer(int(port), instance)
        finally:
            server.send_signal(signal.SIGINT)
            server.wait(ENDS_S)


def _instance(folder: Path, definitions: str) -> Path:
    """Write a workspace with some definitions; return the home of its instance."""
    home = make_home(folder / "home")
    (folder / "definitions.py").write_text(definitions)
    (folder / "workspace.yaml").write_text(WORKSPACE)
    return home
