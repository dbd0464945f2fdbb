"""The interface of a kind of oracle: it maps a run to one number; higher is worse.

How the number becomes a p-value is the same for all kinds (``calibration``). A kind is a plugin:
the built-in ones, those of other distributions, and those in the plugin folder offer themselves
through the hook ``register_oracles``.
"""

import logging
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeAlias

import numpy as np
import pandas as pd
import pluggy
from numpy.typing import NDArray

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.manifest import LABELS
from oracle_pipeline.datasets import is_malicious
from oracle_pipeline.features.manager import plugin_folder, register_others
from oracle_pipeline.features.plugin import PROJECT
from oracle_pipeline.oracles.requirements import Requirement

RELATION = "relation"  # column: what a run is to the runs of its block, as its recipe says
SAME = "same"  # the relation of all runs that are judged

_log = logging.getLogger(__name__)

hookspec = pluggy.HookspecMarker(PROJECT)


# By function and by the identity of a trace: the trace, and what the function returns for it.
_Known: TypeAlias = dict[Hashable, dict[int, tuple[pd.DataFrame, NDArray[np.float64]]]]


class KindError(OracleError):
    """A kind of oracle cannot be used."""


@dataclass(frozen=True, eq=False, slots=True)
class TracedRuns:
    """Runs and their traces, in one order.

    Attributes
    ----------
    table : DataFrame
        One row for each run: the keys and perhaps features.
    traces : tuple of DataFrame
        As of `traces.read_trace`, one for each run.
    """

    table: pd.DataFrame
    traces: tuple[pd.DataFrame, ...]
    _known: _Known = field(default_factory=dict, repr=False)  # shared with those that `where` gives

    def where(self, chosen: NDArray[np.bool_]) -> "TracedRuns":
        """Return the runs of a mask of shape (n_runs,)."""
        kept = tuple(self.traces[row] for row in np.flatnonzero(chosen))
        return TracedRuns(self.table[chosen].reset_index(drop=True), kept, self._known)

    def each(self, compute: Callable[[pd.DataFrame], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return what a function returns for each trace, stacked.

        It is called once for each, however many kinds and folds ask; equal functions are one.
        """
        known = self._known.setdefault(compute, {})
        for trace in self.traces:
            if id(trace) not in known:  # the trace is kept, so its identity stays its own
                known[id(trace)] = trace, compute(trace)
        return np.stack([known[id(trace)][1] for trace in self.traces])

    @property
    def block(self) -> NDArray[np.int64]:
        """Block of each run, shape (n_runs,)."""
        return self.table["block"].to_numpy(dtype=np.int64)

    @property
    def session(self) -> NDArray[np.int64]:
        """Session of each run, shape (n_runs,)."""
        return self.table["session"].to_numpy(dtype=np.int64)

    @property
    def malicious(self) -> NDArray[np.bool_]:
        """Which runs were attacked, shape (n_runs,)."""
        return is_malicious(self.table)

    @property
    def normal(self) -> NDArray[np.bool_]:
        """Which runs are known to be normal, shape (n_runs,); neither: it is not known."""
        return np.asarray(self.table["label"].isin(LABELS), dtype=np.bool_) & ~self.malicious


class Judge(Protocol):
    """A fitted oracle, which maps runs to numbers."""

    def score(self, runs: TracedRuns) -> NDArray[np.float64]:
        """Return how wrong each run is, shape (n_runs,); finite, higher is worse."""


class OracleKind(Protocol):
    """One kind of oracle.

    Attributes
    ----------
    name : str
        One word.
    asks : str
        Input that people must give, in a few words.
    """

    name: str
    asks: str

    def learn(self, normal: TracedRuns) -> Judge:
        """Return what judges runs, learned from normal ones; a kind may be its own judge."""

    def written(self) -> int:
        """Return how many requirements, answers or recordings people gave."""


@dataclass(frozen=True, slots=True)
class Material:
    """The material from which a kind is built.

    Attributes
    ----------
    runs : TracedRuns
        All runs that are compared.
    requirements : sequence of Requirement
        What people require of a run.
    answers : mapping of str to bool
        Whether a run is bad, by run, as people answered.
    follow_ups : TracedRuns or None
        Runs of the same blocks in another relation than `SAME`, with a column `RELATION`. They are
        not judged.
    """

    runs: TracedRuns
    requirements: Sequence[Requirement]
    answers: Mapping[str, bool] = field(default_factory=dict)
    follow_ups: TracedRuns | None = None


Maker = Callable[[Material], OracleKind | None]


class Hooks:
    """The hook that plugins implement."""

    @hookspec
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
        Of plugin files, as for features.

    Raises
    ------
    KindError
        Two kinds have one name.
    """
    from oracle_pipeline.oracles import human, implicit, invariants, metamorphic, specified

    registry = pluggy.PluginManager(PROJECT)
    registry.add_hookspecs(Hooks)
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
