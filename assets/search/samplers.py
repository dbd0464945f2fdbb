"""Samplers that propose the next trial: those of Optuna, and one guided by changed features."""

import warnings
from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, cast, get_args

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial, TrialState

from assets.search.space import SearchError

Sampler: TypeAlias = Literal["tpe", "nsga2", "guided", "random"]

MOVED = "moved"  # attribute of a trial: features that the attack changed
_FIRST = 6  # random trials before any is varied
_STEP = 0.15  # standard deviation of a change, relative to the bounds
_VARIED = 0.5  # share of the values of a trial that are varied
_FROM_FRONT = 0.5  # share of the proposals that vary a trial of the front


def sampler_named(text: str) -> Sampler:
    """Return the name of a sampler.

    Raises
    ------
    SearchError
        The sampler does not exist.
    """
    for name in get_args(Sampler):
        if name == text:
            return cast("Sampler", name)
    raise SearchError(f"There is no sampler {text}; there are {', '.join(get_args(Sampler))}.")


def sampler_for(name: Sampler, seed: int) -> optuna.samplers.BaseSampler:
    """Return a sampler by its name."""
    match name:
        case "tpe":
            warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)
            return optuna.samplers.TPESampler(
                seed=seed, n_startup_trials=_FIRST, multivariate=True, group=True
            )
        case "nsga2":
            return optuna.samplers.NSGAIISampler(seed=seed, population_size=20)
        case "guided":
            return MessageGuidedSampler(seed)
        case _:
            return optuna.samplers.RandomSampler(seed=seed)


class MessageGuidedSampler(optuna.samplers.BaseSampler):
    """Varies trials that changed rarely changed features, after ROFER's guided search.

    Each trial reports which features the attack changed. Half of the proposals vary a trial of the
    front. The others vary any trial, with a probability that grows with the rarity of the features
    that it changed, to explore new behaviour.

    Parameters
    ----------
    seed : int
    """

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._random = optuna.samplers.RandomSampler(seed=seed)
        self._parents: dict[int, FrozenTrial | None] = {}  # by number of the trial that varies them

    def infer_relative_search_space(
        self,
        study: optuna.Study,  # noqa: ARG002
        trial: FrozenTrial,  # noqa: ARG002
    ) -> dict[str, BaseDistribution]:
        """Return no values: they are proposed one by one."""
        return {}

    def sample_relative(
        self,
        study: optuna.Study,  # noqa: ARG002
        trial: FrozenTrial,  # noqa: ARG002
        search_space: dict[str, BaseDistribution],  # noqa: ARG002
    ) -> dict[str, Any]:
        """Return no values: they are proposed one by one."""
        return {}

    def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Choose the parent of the trial."""
        self._parents[trial.number] = self._parent(study)

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Return the parent's value, a value near it, or a random value."""
        parent = self._parents.get(trial.number)
        if parent is not None and param_name in parent.params:
            value = parent.params[param_name]
            if self._rng.random() >= _VARIED:
                return value
            if isinstance(param_distribution, FloatDistribution | IntDistribution):
                return self._near(value, param_distribution)
        return self._random.sample_independent(study, trial, param_name, param_distribution)

    def _parent(self, study: optuna.Study) -> FrozenTrial | None:
        trials = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        if len(trials) < _FIRST:
            return None
        if self._rng.random() < _FROM_FRONT:
            front = study.best_trials
            return front[self._rng.integers(len(front))]
        weights = rarity([trial.user_attrs.get(MOVED, ()) for trial in trials])
        if not weights.any():
            return None
        return trials[self._rng.choice(len(trials), p=weights / weights.sum())]

    def _near(self, value: float, bounds: FloatDistribution | IntDistribution) -> float | int:
        low, high = float(bounds.low), float(bounds.high)
        if bounds.log:
            low, high, value = np.log(low), np.log(high), np.log(value)
        moved = float(np.clip(value + self._rng.normal(0.0, _STEP * (high - low)), low, high))
        moved = float(np.exp(moved)) if bounds.log else moved
        if isinstance(bounds, IntDistribution):
            return round(moved)
        return float(np.clip(moved, bounds.low, bounds.high))


def rarity(moved: Sequence[Sequence[str]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the rarity of each trial: the sum over its features of 1 / trials that changed it.

    Examples
    --------
    >>> rarity([["scan"], ["scan", "odometry"], []]).tolist()
    [0.5, 1.5, 0.0]
    """
    counts = Counter(name for names in moved for name in names)
    return np.array([sum(1.0 / counts[name] for name in names) for names in moved], np.float64)
