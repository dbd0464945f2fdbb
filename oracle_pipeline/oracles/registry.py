"""Finds the kinds of oracle, which are plugins that implement the hook ``register_oracles``.

There are the built-in kinds, those of other distributions, and those in the plugin folder.
"""

import logging
from pathlib import Path

import pluggy

from oracle_pipeline.features.engine.plugin import PROJECT
from oracle_pipeline.features.manager import plugin_folder, register_others
from oracle_pipeline.oracles import human, implicit, invariants, metamorphic, specified
from oracle_pipeline.oracles.kind import KindError, Maker, Material, OracleKind

_log = logging.getLogger(__name__)
_hookspec = pluggy.HookspecMarker(PROJECT)


class OracleHooks:
    """The hook that plugins implement."""

    @_hookspec
    def register_oracles(self) -> list[Maker]:  # type: ignore[empty-body]
        """Return the factories of the kinds of oracle that a module offers.

        Each takes a `Material` and returns a fresh, unfitted kind, or None if the material lacks
        what the kind needs.
        """


def build_kinds(material: Material, folder: Path | None = None) -> list[OracleKind]:
    """Build the kinds of oracle: built-in ones, then entry points, then the files of a folder.

    Parameters
    ----------
    material : Material
    folder : Path, optional
        Folder of plugin files, as for features.

    Raises
    ------
    KindError
        Two kinds have the same name.
    """
    registry = pluggy.PluginManager(PROJECT)
    registry.add_hookspecs(OracleHooks)
    for module in (implicit, specified, invariants, metamorphic, human):
        registry.register(module)
    for name, reason in register_others(registry, folder or plugin_folder())[1].items():
        _log.error("Plugin %s is left out: %s", name, reason)
    kinds: list[OracleKind] = []
    for implementation in registry.hook.register_oracles.get_hookimpls():
        makers: list[Maker] = implementation.function()  # type: ignore[assignment]  # untyped hook
        made = (make(material) for make in makers)
        kinds += [kind for kind in made if kind is not None]
    names = [kind.name for kind in kinds]
    for name in names:
        if names.count(name) > 1:
            raise KindError(f"Two kinds of oracle are called {name!r}; rename one.")
    return kinds
