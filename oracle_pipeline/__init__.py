"""The analysis of recordings: features, datasets, clusters, verdicts and reports."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oracle_pipeline.api import ReferenceCard, Verdicts, compare, learn, score

__all__ = ["ReferenceCard", "Verdicts", "compare", "features", "learn", "score"]


def __getattr__(name: str) -> Any:
    """Return a name of the Python API, which is imported when it is first used."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    if name == "features":
        return import_module("oracle_pipeline.features")
    return getattr(import_module("oracle_pipeline.api"), name)
