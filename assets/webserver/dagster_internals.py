"""The private names of Dagster that only the server of the UI needs."""

from dagster._cli.proxy_server_manager import ProxyServerManager as ProxyServerManager
from dagster._cli.utils import get_instance_for_cli as get_instance_for_cli
from dagster._core.workspace.context import WorkspaceProcessContext as WorkspaceProcessContext
from dagster._core.workspace.load_target import WorkspaceFileTarget as WorkspaceFileTarget
from dagster._utils.log import configure_loggers as configure_loggers
