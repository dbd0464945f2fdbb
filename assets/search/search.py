"""The loop of a search: Optuna proposes, trials run, Optuna learns from the results.

The study is stored on disk and can be resumed. Trials are proposed in rounds, one trial per worker.
The sampler receives results in the order of trial numbers, so the same seed and number of workers
give the same search.
"""

import dataclasses
import math
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import optuna
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.study import StudyDirection

from assets.search.attack_space import AttackSpace, SearchError
from assets.search.closed_loop import ClosedLoop, Finding, Proposal
from assets.search.composed_attacks import composed_attacks
from assets.search.impact import ImpactSampler
from assets.search.oracles import find_oracle
from assets.search.scenario_parameters import scenario_attacks
from sim.campaigns import Campaign
from sim.fan_out import fan_out, process_pool
from sim.modes import find_mode

CONTROLS = "controls"  # folder of the runs without an attack, in that of the search
JOURNAL = "study.journal"
Sampler: TypeAlias = Literal["tpe", "guided", "random"]
_DIRECTIONS = (StudyDirection.MAXIMIZE, StudyDirection.MINIMIZE)  # of the values of `evasion`
_ENOUGH = 3.0  # larger effects do not count: a stuck robot is not informative
_BEYOND_ALL = 1e9
_FINDING = "finding"
_FIRST = 6  # random trials before a sampler learns


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """The settings of a search.

    Attributes
    ----------
    oracle : str
        What to search against: a reference card, a file of requirements, or a kind of oracle.
    campaign : Campaign
        Settings of all runs, except goals and time limit.
    blocks : int
        Number of blocks that trials alternate over.
    goals : int
        Of each run.
    time_limit : float
        Simulated seconds that a goal may take, on average.
    far : float
        False positive rate at which the oracle decides.
    normal : Path, optional
        Folder of normal recordings, for an oracle that is not a card.
    feedback : str, optional
        What guides the search instead of the effect.
    """

    oracle: str
    campaign: Campaign
    sampler: Sampler = "tpe"
    blocks: int = 3
    goals: int = 1
    time_limit: float = 120.0
    far: float = 0.05
    normal: Path | None = None
    feedback: str | None = None
    screen: bool = True
    allow_actuation: bool = False
    ranges: tuple[str, ...] = ()  # NAME=LOW:HIGH, of a scenario's parameters
    topics: tuple[str, ...] = ()  # without a scenario
    operators: tuple[str, ...] = ()

    def closed_loop(self, controls: Path) -> ClosedLoop:
        """Return what runs and judges the proposals."""
        campaign = dataclasses.replace(
            self.campaign, goals_per_run=self.goals, timeout_s=self.time_limit * self.goals
        )
        oracle = find_oracle(self.oracle, self.normal, self.far, controls)
        return ClosedLoop(campaign, oracle, self.screen, controls, feedback=self.feedback)


def attacks(scenario: str | None, controls: Path, settings: SearchSettings) -> AttackSpace:
    """Return the attacks of a scenario, or of topics and operators if it is None.

    Raises
    ------
    OracleError
        A name does not exist, or nothing can be varied.
    """
    if scenario is not None:
        mode = find_mode(scenario, allow_actuation=settings.allow_actuation)
        return scenario_attacks(mode, settings.ranges)
    control = settings.closed_loop(controls).run_control(0)
    available = {topic: count.type for topic, count in control.topics.items()}
    return composed_attacks(
        settings.topics, settings.operators, available, allow_actuation=settings.allow_actuation
    )


@dataclass(frozen=True, slots=True)
class TrialBudget:
    """The end of a search: after a number of trials, including earlier ones, or after a time."""

    trials: float = float("inf")
    seconds: float = float("inf")

    @classmethod
    def parse(cls, text: str) -> "TrialBudget":
        """Read ``200`` trials, ``30m`` minutes or ``2h`` hours.

        Raises
        ------
        SearchError
            If the text is invalid.
        """
        number, unit = (text[:-1], text[-1]) if text.endswith(("m", "h")) else (text, "")
        if not (number.isdecimal() and int(number) > 0):
            raise SearchError(f"expected a budget such as 200, 30m or 2h, found {text!r}.")
        if unit:
            return cls(seconds=int(number) * {"m": 60.0, "h": 3600.0}[unit])
        return cls(trials=int(number))


class Search:
    """A search for attacks.

    Parameters
    ----------
    folder : Path
        Where the study is stored. An existing study is resumed.
    space : AttackSpace
    settings : SearchSettings
    controls : Path
        Folder of the runs without an attack; searches of the same settings may share it.
    seed : int
        Of the proposals.
    """

    def __init__(
        self, folder: Path, space: AttackSpace, settings: SearchSettings, controls: Path, seed: int
    ) -> None:
        self._space, self._settings = space, settings
        self._loop = dataclasses.replace(
            settings.closed_loop(controls), conditions=space.conditions, control=space.control
        )
        folder.mkdir(parents=True, exist_ok=True)
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        try:
            self._study = optuna.create_study(
                storage=JournalStorage(JournalFileBackend(str(folder / JOURNAL))),
                study_name=space.id,
                directions=_DIRECTIONS,
                load_if_exists=True,
            )
        except ValueError as error:
            raise SearchError(
                f"{folder} has another search: {error}; choose another folder."
            ) from error
        # After resuming, proposals must not repeat.
        self._study.sampler = _sampler(settings.sampler, seed + len(self._study.trials))

    @property
    def findings(self) -> list[Finding]:
        """The findings of all trials, in the order of their numbers."""
        documents = [trial.user_attrs.get(_FINDING) for trial in self._study.trials]
        return [_from_dict(document) for document in documents if document]

    @property
    def front(self) -> list[Finding]:
        """The findings on the Pareto front."""
        return [_from_dict(trial.user_attrs[_FINDING]) for trial in self._study.best_trials]

    def run(
        self, budget: TrialBudget, workers: int, failed: Callable[[str], None]
    ) -> Iterator[Finding]:
        """Yield the findings of trials as they arrive, until the budget is used up.

        Parameters
        ----------
        budget : TrialBudget
        workers : int
            Number of parallel trials.
        failed : callable
            Called with the reason for each failed trial.
        """
        blocks, pool = range(self._settings.blocks), partial(process_pool, workers)
        for outcome in fan_out(self._loop.run_control, blocks, pool):
            if outcome.error is not None:
                raise SearchError(f"Block {outcome.job} cannot be run: {outcome.error}")
        self._loop.judged_control(Proposal(0, 0, {}, {}))  # an unusable oracle ends the search here
        executor = pool()
        ends = time.monotonic() + budget.seconds
        try:
            while (left := budget.trials - len(self._study.trials)) > 0:
                if time.monotonic() >= ends:
                    return
                yield from self._round(executor, int(min(workers, left)), failed)
        finally:
            executor.shutdown(cancel_futures=True)

    def _round(
        self, executor: Executor, size: int, failed: Callable[[str], None]
    ) -> Iterator[Finding]:
        """Yield the findings of some trials that run at the same time."""
        trials = [self._study.ask() for _ in range(size)]
        futures = [executor.submit(self._loop.run_trial, self._proposal(each)) for each in trials]
        for trial, future in zip(trials, futures, strict=True):
            if error := future.exception():
                self._study.tell(trial, state=optuna.trial.TrialState.FAIL)
                failed(f"trial {trial.number}: {error}")
            else:
                finding = future.result()
                trial.set_user_attr(_FINDING, dataclasses.asdict(finding))
                self._study.tell(trial, evasion(finding))
                yield finding

    def _proposal(self, trial: optuna.Trial) -> Proposal:
        attack = self._space.suggest(trial)
        block = trial.number % self._settings.blocks
        return Proposal(trial.number, block, attack.document, attack.values)


def evasion(finding: Finding) -> tuple[float, float]:
    """Return the bounded effect or feedback, and how clearly the oracle detects the run.

    Without bounds, the front would consist of stuck robots, which every oracle detects, and of
    attacks without an effect.
    """
    reached = finding.effect if finding.feedback is None else finding.feedback
    score = _ordered(finding.score)
    distance = 0.0 if finding.passed else math.copysign(math.log1p(abs(score)), score)
    return min(_ordered(reached), _ENOUGH), distance


def _ordered(value: float) -> float:
    """Return a sortable number; one that is not finite becomes larger than all others."""
    return value if math.isfinite(value) else _BEYOND_ALL


def _sampler(name: Sampler, seed: int) -> BaseSampler:
    match name:
        case "tpe":
            warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)
            return TPESampler(seed=seed, n_startup_trials=_FIRST, multivariate=True, group=True)
        case "guided":
            return ImpactSampler(seed, _FIRST)
        case "random":
            return RandomSampler(seed=seed)


def _from_dict(document: Mapping[str, Any]) -> Finding:
    lists = {name: tuple(document[name]) for name in ("families", "moved")}
    try:
        return Finding(**{**document, **lists, "proposal": Proposal(**document["proposal"])})
    except TypeError as error:
        raise SearchError(
            "the search was begun with another release; choose another folder."
        ) from error
