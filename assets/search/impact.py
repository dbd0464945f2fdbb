"""What the effect of attacks depends on, and a sampler that changes it in attacks that did well.

ROFER spends its mutations on the dimensions of a program's input with the largest impact. Here a
dimension is a parameter of the attack, such as topic, field or onset.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from optuna.samplers import RandomSampler
from optuna.study import Study
from optuna.trial import FrozenTrial, TrialState

_CHANGED = 2  # parameters of a proposal
_LEAST = 0.05  # weight of a parameter without impact
_BINS = 4  # of the values of a number


def impacts(given: Sequence[Mapping[str, Any]], reached: Sequence[float]) -> dict[str, float]:
    """Return the share of a result's variance that lies between the values of each parameter.

    Parameters
    ----------
    given : sequence of mappings
        Values of parameters, by name; not all have all of them.
    reached : sequence of float
        The result for each.
    """
    found = {}
    for name in dict.fromkeys(name for values in given for name in values):
        rows = [row for row, values in enumerate(given) if name in values]
        results = np.array([reached[row] for row in rows])
        groups = np.array([given[row][name] for row in rows])
        if groups.dtype.kind in "if":
            groups = groups.argsort().argsort() * _BINS // len(groups)
        _, group, count = np.unique(groups, return_inverse=True, return_counts=True)
        means = np.bincount(group, results) / count
        found[name] = float(means[group].var() / max(results.var(), 1e-9))
    return found


class ImpactSampler(RandomSampler):
    """Takes a trial of the front, and draws a few of its parameters again, by their impact.

    Parameters
    ----------
    seed : int
    first : int
        Random trials before it learns.
    """

    def __init__(self, seed: int, first: int) -> None:
        super().__init__(seed)
        self._choices, self._first = np.random.default_rng(seed), first
        self._kept: dict[int, dict[str, Any]] = {}  # by number of the trial

    def before_trial(self, study: Study, trial: FrozenTrial) -> None:
        """Choose what a proposal keeps."""
        known = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        if len(known) < self._first:
            return
        kept = dict(self._choices.choice(np.array(study.best_trials, dtype=object)).params)
        impact = impacts([each.params for each in known], [each.values[0] for each in known])
        weights = np.array([max(_LEAST, impact[name]) for name in kept])
        for name in self._choices.choice(
            list(kept), min(_CHANGED, len(kept)), replace=False, p=weights / weights.sum()
        ):
            del kept[name]
        self._kept[trial.number] = kept

    def sample_independent(
        self, study: Study, trial: FrozenTrial, param_name: str, param_distribution: Any
    ) -> Any:
        """Return the kept value of a parameter, or a random one."""
        if param_name in (kept := self._kept.get(trial.number, {})):
            return kept[param_name]
        return super().sample_independent(study, trial, param_name, param_distribution)
