"""What the assets are made with: hashes of the source files behind them.

A changed hash makes an asset stale in the UI and its files be made again.
"""

import functools
import os
from importlib.metadata import entry_points
from importlib.resources import files
from pathlib import Path

from sim.software import source_digest

_PLUGIN_FOLDER, _PLUGIN_GROUP = "ORACLE_PLUGINS", "oracle_pipeline"
_FEATURE_PARTS = ("bags", "graphs", "features")


@functools.cache
def analysis_code() -> str:
    """Return the version of everything that turns feature tables into reports."""
    return source_digest([files("oracle_pipeline")])


@functools.cache
def feature_code() -> str:
    """Return the version of everything that turns a run into features, plugins included."""
    package = files("oracle_pipeline")  # naming a part of it would import all that it needs
    folders = [package / part for part in _FEATURE_PARTS]
    if folder := os.environ.get(_PLUGIN_FOLDER):
        folders.append(Path(folder))
    plugins = [
        f"{plugin.name} {plugin.value} {plugin.dist.version if plugin.dist else ''}"
        for plugin in sorted(entry_points(group=_PLUGIN_GROUP))
    ]
    return source_digest(folders, *plugins)
