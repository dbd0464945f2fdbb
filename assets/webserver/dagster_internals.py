"""The private names of Dagster that only the server of the UI needs."""

from dagster._cli.proxy_server_manager import ProxyServerManager
from dagster._cli.utils import get_instance_for_cli
from dagster._core.workspace.context import WorkspaceProcessContext
from dagster._core.workspace.load_target import WorkspaceFileTarget
from dagster._utils.log import configure_loggers

__all__ = [
    "ProxyServerManager",
    "WorkspaceFileTarget",
    "WorkspaceProcessContext",
    "configure_loggers",
    "get_instance_for_cli",
]
