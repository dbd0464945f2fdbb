"""What the assets are made with: hashes of the source files behind them.

A changed hash makes an asset stale in the UI and its files be made again.
"""

import functools
import hashlib
import os
from importlib.metadata import entry_points
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

_PLUGIN_FOLDER, _PLUGIN_GROUP = "ORACLE_PLUGINS", "oracle_pipeline"
_FEATURE_PARTS = ("bags", "graphs", "features")
_SUFFIXES = (".py", ".msg", ".srv", ".action", ".j2")


@functools.cache
def analysis_code() -> str:
    """Return the version of everything that turns feature tables into reports."""
    return _digest(_sources(files("oracle_pipeline")))


@functools.cache
def feature_code() -> str:
    """Return the version of everything that turns a run into features, plugins included."""
    package = files("oracle_pipeline")  # naming a part of it would import all that it needs
    sources = [source for part in _FEATURE_PARTS for source in _sources(package / part)]
    if folder := os.environ.get(_PLUGIN_FOLDER):
        sources += _sources(Path(folder))
    for plugin in sorted(entry_points(group=_PLUGIN_GROUP)):
        version = plugin.dist.version if plugin.dist else ""
        sources.append(f"{plugin.name} {plugin.value} {version}".encode())
    return _digest(sources)


def _sources(folder: Traversable) -> list[bytes]:
    found = []
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            found += _sources(entry)
        elif entry.name.endswith(_SUFFIXES):
            found += [entry.name.encode(), entry.read_bytes()]
    return found


def _digest(parts: list[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8) + part)
    return digest.hexdigest()[:16]
