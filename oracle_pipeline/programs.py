"""Entry points of the programs in the packages ``assets``, ``resources`` and ``sim``.

These are common names. If another distribution or folder has a package of the same name, Python may
import that one. Where this module has been imported first, ours are found; if another one had been
imported even before, an error message explains the clash.
"""

import pkgutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from oracle_pipeline.bags.processes import collect_rarely

_OURS = ("assets", "resources", "sim")
_ROOT = Path(__file__).parents[1]  # the folder of all our packages


class _OwnPackages(MetaPathFinder):
    """Finds our packages in the folder of this distribution, and nothing else."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return where one of our packages is; None for any other module."""
        if path is None and name in _OURS:
            return PathFinder.find_spec(name, [str(_ROOT)], target)
        return None


sys.meta_path.insert(0, _OwnPackages())


def oracle_sim() -> None:
    """Run ``oracle-sim``."""
    _run("assets.oracle_sim:main")


def oracle_ui() -> None:
    """Run ``oracle-ui``."""
    _run("assets.webserver.server:main")


@contextmanager
def explain_clashes() -> Iterator[None]:
    """Explain import errors caused by a clash of package names.

    Raises
    ------
    ImportError
        The original error, with an explanation if another package hides one of ours.
    """
    try:
        yield
    except ImportError as error:
        if explanation := _clash():
            raise ImportError(explanation) from error
        raise


def _run(place: str) -> None:
    """Run the program at a place, ``module:attribute``."""
    collect_rarely()
    try:
        with explain_clashes():
            pkgutil.resolve_name(place)()
    except ImportError as error:
        sys.exit(f"Error: {error}")


def _clash() -> str:
    """Return a sentence on the package that hides one of ours; empty without one."""
    for name in _OURS:
        found = find_spec(name)
        places = [] if found is None else [*(found.submodule_search_locations or ())]
        if str(_ROOT / name) not in places:
            where = ", ".join(places) or (found and found.origin) or "no folder"
            return (
                f"Python finds the package {name!r} of ros2-behaviour-oracle in {where} instead of "
                f"{_ROOT / name}. Another package has the same name: install this one into a "
                "separate virtual environment, or start the command in another folder."
            )
    return ""
