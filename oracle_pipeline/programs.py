"""Entry points of the programs whose code lives in the packages above this one.

``assets``, ``resources`` and ``sim`` are common names. If another distribution or folder has a
package of the same name, Python may import that one. The error message here explains such a clash.
"""

import pkgutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

_OURS = ("assets", "resources", "sim")
_ROOT = Path(__file__).parents[1]  # the folder that all our packages are in


def oracle_sim() -> None:
    """Run ``oracle-sim``."""
    _run("resources.cli:main")


def oracle_ui() -> None:
    """Run ``oracle-ui``."""
    _run("resources.ui.server:main")


@contextmanager
def clashes_explained() -> Iterator[None]:
    """Explain an import error that a clash of names has caused.

    Raises
    ------
    ImportError
        The original error, with an explanation if another package hides one of ours.
    """
    try:
        yield
    except ImportError as error:
        if told := _clash():
            raise ImportError(told) from error
        raise


def _run(place: str) -> None:
    """Run the program at a place, ``module:attribute``."""
    try:
        with clashes_explained():
            program = pkgutil.resolve_name(place)
    except ImportError as error:
        sys.exit(f"Error: {error}")
    program()


def _clash() -> str:
    """Return a sentence on what hides one of our packages; empty if nothing does."""
    for name in _OURS:
        found = find_spec(name)
        places = [] if found is None else [*(found.submodule_search_locations or ())]
        if str(_ROOT / name) not in places:
            where = ", ".join(places) or (found and found.origin) or "no folder"
            return (
                f"Python finds the package {name!r} of ros2-behaviour-oracle in {where} instead of "
                f"{_ROOT / name}. Another package has the same name: install this one into a "
                "virtual environment of its own, or start the command in another folder."
            )
    return ""
