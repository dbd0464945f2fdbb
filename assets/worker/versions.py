"""Code versions of the assets: hashes of the source files that they depend on.

If a hash changes, the UI shows the asset as stale, and its files are computed again.
"""

import functools
import os
from importlib.metadata import entry_points
from pathlib import Path

from oracle_pipeline.bags.sources import ROOT, code_hash

_PLUGIN_FOLDER, _PLUGIN_GROUP = "ORACLE_PLUGINS", "oracle_pipeline"
_ANALYSIS = "oracle_pipeline"
_EXTRACTED_BY = ("oracle_pipeline.opened_run", "oracle_pipeline.features")
_READ_BY = "assets.aggregates"  # shared by all assets over all runs


@functools.cache
def analysis_code(module: str, root: Path = ROOT) -> str:
    """Return the version of the code that computes the results of a module of assets.

    Parameters
    ----------
    module
        The module that defines the assets.
    root
        The folder of this project's packages.
    """
    return code_hash([module, _READ_BY], within=[_ANALYSIS], root=root)


@functools.cache
def feature_code(root: Path = ROOT) -> str:
    """Return the version of everything that turns a run into features, plugins included.

    Parameters
    ----------
    root
        The folder of this project's packages.
    """
    folder = os.environ.get(_PLUGIN_FOLDER)
    plugins = [
        f"{plugin.name} {plugin.value} {plugin.dist.version if plugin.dist else ''}"
        for plugin in sorted(entry_points(group=_PLUGIN_GROUP))
    ]
    folders = [Path(folder)] if folder else []
    return code_hash(_EXTRACTED_BY, *plugins, folders=folders, root=root)
