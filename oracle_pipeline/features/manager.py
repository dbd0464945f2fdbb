"""Finds the feature plugins: built-in ones, and those of other distributions and of a folder.

Every test and worker builds its own manager with ``build_manager``. A file of the folder may have
both forms: a ``register_features`` hook, and classes in the thesis's form.
"""

import importlib.metadata
import importlib.util
import inspect
import logging
import os
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pluggy

from oracle_pipeline.features.adapters.ros_stand_ins import stand_ins
from oracle_pipeline.features.adapters.thesis import FeatureExtractionPlugin, ThesisPlugin
from oracle_pipeline.features.air_traffic import adsb_reports, fused_tracks
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.lidar import (
    costmap_consistency,
    laser_ranges,
    local_costmap,
    map_consistency,
    permanence,
    redundancy,
    scan,
    scan_noise,
)
from oracle_pipeline.features.motion import kinematics, localisation, odometry, transforms, velocity
from oracle_pipeline.features.navigation import goals, progress
from oracle_pipeline.features.traffic import (
    delays,
    generic,
    message_traffic,
    structural,
    thesis_features,
    topic_pairs,
)

FOLDER_VARIABLE = "ORACLE_PLUGINS"

_BUILT_IN = (
    structural, odometry, laser_ranges, goals, thesis_features, message_traffic, generic,
    topic_pairs, redundancy, scan, scan_noise, permanence, kinematics, transforms, delays,
    map_consistency, costmap_consistency, progress, velocity, localisation, local_costmap,
    adsb_reports, fused_tracks,
)  # fmt: skip

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FeatureManager:
    """The plugins in use, in the order of their columns."""

    plugins: tuple[fp.FeaturePlugin, ...]
    thesis: tuple[ThesisPlugin, ...] = ()
    broken: dict[str, str] = field(default_factory=dict)  # reasons by plugin that failed to load
    folder: Path | None = None  # from which plugins were loaded

    def features(self) -> dict[str, fp.Feature]:
        """Return the feature of each column of the native plugins."""
        return {p.column(feature): feature for p in self.plugins for feature in p.features}


def build_manager(folder: Path | None = None) -> FeatureManager:
    """Collect the plugins: built in, then entry points, then the files of a folder, by name.

    Plugins that cannot be loaded are logged and listed in ``broken``.

    Parameters
    ----------
    folder : Path, optional
        Folder of plugin files; by default the value of ``ORACLE_PLUGINS``, if it is set.

    Raises
    ------
    PluginError
        If the folder is missing, or two plugins offer the same column.
    """
    folder = folder or plugin_folder()
    registry = pluggy.PluginManager(fp.PROJECT)
    registry.add_hookspecs(fp.FeatureHooks)
    for module in _BUILT_IN:
        registry.register(module)
    modules, broken = register_others(registry, folder)
    plugins = _offered(registry, broken)
    manager = FeatureManager(plugins, _thesis_plugins(modules, broken), broken, folder)
    for name, reason in broken.items():
        _log.error("Plugin %s is left out: %s", name, reason)
    _check_names(manager.plugins)
    return manager


def plugin_folder() -> Path | None:
    """Return the folder in ``ORACLE_PLUGINS``, if it is set."""
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else None


def register_others(
    registry: pluggy.PluginManager, folder: Path | None
) -> tuple[dict[str, ModuleType], dict[str, str]]:
    """Register the plugins of entry points, and those in the files of a folder.

    Returns
    -------
    tuple
        The modules of the folder by name, and the reasons for plugins that could not be loaded.

    Raises
    ------
    PluginError
        If the folder is missing.
    """
    broken: dict[str, str] = {}
    _register_entry_points(registry, broken)
    modules = _load_folder(registry, folder, broken) if folder is not None else {}
    return modules, broken


def _register_entry_points(registry: pluggy.PluginManager, broken: dict[str, str]) -> None:
    for entry_point in sorted(importlib.metadata.entry_points(group=fp.PROJECT)):
        try:
            registry.register(entry_point.load(), entry_point.name)
        except Exception as error:  # foreign code
            broken[entry_point.name] = _reason(error)


def _load_folder(
    registry: pluggy.PluginManager, folder: Path, broken: dict[str, str]
) -> dict[str, ModuleType]:
    if not folder.is_dir():
        raise fp.PluginError(
            f"There is no plugin folder {folder}; create it, or set {FOLDER_VARIABLE} to another."
        )
    modules: dict[str, ModuleType] = {}
    for path in sorted(folder.glob("*.py")):
        try:
            module = _load(path)
            registry.register(module, path.stem)
            modules[path.stem] = module
        except Exception as error:  # foreign code
            broken[path.stem] = _reason(error)
    return modules


def _load(path: Path) -> ModuleType:
    """Import a file under a unique name; the thesis's files import ``plugin_interface``."""
    spec = importlib.util.spec_from_file_location(f"oracle_plugins.{path.stem}", path)
    assert spec is not None  # noqa: S101 -- a .py file has a loader
    assert spec.loader is not None  # noqa: S101
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    interface = ModuleType("plugin_interface")
    vars(interface)["FeatureExtractionPlugin"] = FeatureExtractionPlugin
    shadowed = sys.modules.get("plugin_interface")
    sys.modules["plugin_interface"] = interface
    try:
        with stand_ins():
            spec.loader.exec_module(module)
    finally:
        del sys.modules["plugin_interface"]
        if shadowed is not None:
            sys.modules["plugin_interface"] = shadowed
    return module


def _offered(
    registry: pluggy.PluginManager, broken: dict[str, str]
) -> tuple[fp.FeaturePlugin, ...]:
    plugins: list[fp.FeaturePlugin] = []
    for implementation in registry.hook.register_features.get_hookimpls():
        try:
            plugins += _checked(implementation.function())
        except Exception as error:  # foreign code
            broken[implementation.plugin_name] = _reason(error)
    return tuple(plugins)


def _checked(offered: Any) -> list[fp.FeaturePlugin]:
    if not isinstance(offered, list) or not all(isinstance(p, fp.FeaturePlugin) for p in offered):
        raise TypeError("register_features must return a list of FeaturePlugin")
    return offered


def _thesis_plugins(
    modules: dict[str, ModuleType], broken: dict[str, str]
) -> tuple[ThesisPlugin, ...]:
    plugins: list[ThesisPlugin] = []
    for stem, module in modules.items():
        classes = _classes(module)
        for each in classes:
            name = stem if len(classes) == 1 else f"{stem}_{each.__name__}"
            try:
                plugins.append(ThesisPlugin(name, each()))
            except Exception as error:  # foreign code
                broken[f"thesis.{name}"] = _reason(error)
    return tuple(plugins)


def _classes(module: ModuleType) -> list[type[FeatureExtractionPlugin]]:
    """Return the classes in the thesis's form that a file defines, not those it imports."""
    return [
        each
        for _, each in inspect.getmembers(module, inspect.isclass)
        if issubclass(each, FeatureExtractionPlugin) and each.__module__ == module.__name__
    ]


def _check_names(plugins: tuple[fp.FeaturePlugin, ...]) -> None:
    """Raise `PluginError` if two plugins or two columns have the same name."""
    names = Counter(plugin.name for plugin in plugins)
    for name in (name for name, count in names.items() if count > 1):
        raise fp.PluginError(f"{names[name]} plugins are called {name!r}; rename all but one.")
    offered: dict[str, str] = {}
    for plugin in plugins:
        for column in map(plugin.column, plugin.features):
            if column in offered:
                raise fp.PluginError(
                    f"Feature {column!r} is offered twice, by {offered[column]} and by "
                    f"{plugin.name}; rename one or leave its plugin out."
                )
            offered[column] = plugin.name


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
