"""Entry points of the programs in the packages ``assets``, ``resources`` and ``sim``.

These are common names. If another distribution or folder has a package of the same name, Python may
import that one. This module explains such a clash in an error message.
"""

import pkgutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

_OURS = ("assets", "resources", "sim")
_ROOT = Path(__file__).parents[1]  # the folder of all our packages


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
