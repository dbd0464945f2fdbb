"""``oracle-ui``: the pipeline in the browser, behind the guard, with Dagster's daemon beside it.

It replaces ``dagster dev``, whose web server cannot be put behind a guard: it starts one code
server for each code location, shared by web server and daemon. The web server runs in this process.
"""

import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import click
import uvicorn
import yaml
from dagster import DagsterInstance
from dagster_webserver.app import create_app_from_workspace_process_context
from dagster_webserver.version import __version__

from assets.webserver import dagster_internals
from assets.webserver.metrics import metrics_route
from assets.webserver.report import report_route
from oracle_pipeline.bags.terminal import version_option
from oracle_pipeline.web_guard import VARIABLE, Guard, OriginError, parse_origins
from resources.bulk_commits import commit_in_bulk
from resources.run_processes import fail_lost_runs
from resources.store import RunStore

PORT = 3000  # Dagster's own default
DAEMON_ENDS_S = 60
CONNECTIONS_END_S = 5
_PROJECT = Path(__file__).parent.parent.parent
_log = logging.getLogger("dagster.ui")


@click.command()
@version_option
@click.option(
    "-w", "--workspace", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Which code locations to serve.  [default: workspace.yaml here, or that of the project]",
)  # fmt: skip
@click.option("-h", "--host", default="127.0.0.1", show_default=True, help="Address to listen at.")
@click.option(
    "-p", "--port", type=click.IntRange(1, 65535),
    help=f"Port to listen at.  [default: {PORT}, or a free one if that is taken]")  # fmt: skip
@click.option(
    "--webserver-only", is_flag=True,
    help="Start no daemon and no code server: they run elsewhere, as in deploy/.")  # fmt: skip
def main(workspace: Path | None, host: str, port: int | None, webserver_only: bool) -> None:
    """Open the pipeline in the browser; Control-C ends it.

    Only this machine reaches it, and only its own pages can change anything. To let other people
    in, put a proxy with a login in front of it, and name its address in ORACLE_UI_ORIGINS (see
    docs/how-to/security.md).

    \b
    Examples:
        oracle-ui
        oracle-ui -p 8080
    """  # noqa: D301 -- click reads the control character
    for number in (signal.SIGINT, signal.SIGTERM):  # some shells ignore them for child processes
        signal.signal(number, signal.default_int_handler)
    workspace = (workspace or _default_workspace()).absolute()
    dagster_internals.configure_loggers()
    commit_in_bulk()
    with contextlib.suppress(KeyboardInterrupt), contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.chdir(workspace.parent))  # `.env` and `data` are there
        os.environ["ORACLE_DAGSTER_HOME"] = str(workspace.parent / ".dagster_home")
        instance = stack.enter_context(dagster_internals.get_instance_for_cli())
        for run in fail_lost_runs(instance):
            _log.warning("The process of run %s is gone; it is marked as failed.", run)
        if not webserver_only:
            workspace = stack.enter_context(_shared_code_servers(instance, workspace))
        server = stack.enter_context(_web_server(instance, workspace))
        if not webserver_only:
            stack.enter_context(_daemon(workspace, server))
        with _listener(host, port) as listener:
            _log.info("The UI is at http://%s:%s", *listener.getsockname()[:2])
            server.run([listener])
            # A signal raises an exception, so the server returns only if the daemon has ended.
            raise click.ClickException("Dagster's daemon has ended; the reason is above.")


def _default_workspace() -> Path:
    """Return the workspace of this folder, or of the project that this module belongs to."""
    for place in (Path("workspace.yaml"), _PROJECT / "workspace.yaml"):
        if place.is_file():
            return place
    raise click.UsageError("There is no workspace.yaml here; give one with -w.")


@contextlib.contextmanager
def _shared_code_servers(instance: DagsterInstance, workspace: Path) -> Iterator[Path]:
    """Start a code server for each location; yield a workspace file with the servers."""
    target = dagster_internals.WorkspaceFileTarget(paths=[str(workspace)])
    with (
        dagster_internals.ProxyServerManager(instance, target, "WARNING") as servers,
        tempfile.TemporaryDirectory(prefix="oracle-ui-") as folder,
    ):
        shared = Path(folder, "workspace.yaml")
        shared.write_text(yaml.safe_dump({"load_from": list(servers.get_code_server_specs())}))
        yield shared


@contextlib.contextmanager
def _web_server(instance: DagsterInstance, workspace: Path) -> Iterator[uvicorn.Server]:
    """Yield Dagster's web server, behind the guard."""
    try:
        origins = parse_origins(os.environ.get(VARIABLE, ""))
    except OriginError as error:
        raise click.UsageError(str(error)) from error
    target = dagster_internals.WorkspaceFileTarget(paths=[str(workspace)])
    with dagster_internals.WorkspaceProcessContext(
        instance, target, version=__version__
    ) as context:
        dagster = create_app_from_workspace_process_context(context)
        store = RunStore(root=os.environ.get("ORACLE_HOME") or "data")
        dagster.router.routes.insert(0, metrics_route(instance, store))
        if store.is_local:
            dagster.router.routes.insert(0, report_route(store.report.parent))
        app = Guard(dagster, origins)
        yield uvicorn.Server(
            uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=CONNECTIONS_END_S)
        )


@contextlib.contextmanager
def _daemon(workspace: Path, server: uvicorn.Server) -> Iterator[None]:
    """Run Dagster's daemon; the web server stops if the daemon ends."""
    command = [sys.executable, "-m", "dagster._daemon", "run", "-w", str(workspace)]
    # In a new session, so that Control-C reaches only this process, which stops the others.
    daemon = subprocess.Popen(command, start_new_session=True)

    def stop_server() -> None:
        daemon.wait()
        server.should_exit = True

    threading.Thread(target=stop_server, daemon=True).start()
    try:
        yield
    finally:
        daemon.terminate()
        try:
            daemon.wait(DAEMON_ENDS_S)
        except subprocess.TimeoutExpired:
            daemon.kill()


def _listener(host: str, port: int | None) -> socket.socket:
    """Return a listening socket: at the port, else at Dagster's own, else at a free one."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for wanted in [port] if port else [PORT, 0]:
        try:
            return socket.create_server((host, wanted), family=family, backlog=2048)
        except OSError as error:
            refused = error
            _log.warning("Cannot listen at port %s of %s: %s", wanted, host, error.strerror)
    raise click.ClickException(
        f"Cannot listen at {host}: {refused.strerror}. Choose another address with -h or -p."
    )
