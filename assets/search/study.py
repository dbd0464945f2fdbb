"""The loop of a search: propose, run, learn. It is stored on disk and can be resumed.

Trials are proposed in rounds, one trial per worker. The sampler receives results in the order of
trial numbers, so the same seed and number of workers give the same search.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from assets.search.attacks import Template
from assets.search.closed_loop import Finding, Proposal, Setting, run_control, run_trial
from assets.search.objectives import Objective
from assets.search.samplers import MOVED, Sampler, sampler_for
from assets.search.space import SearchError
from sim.fan_out import fan_out, process_pool

JOURNAL = "study.journal"
_FINDING = "finding"


@dataclasses.dataclass(frozen=True, slots=True)
class Budget:
    """The end of a search: after a number of trials, including earlier ones, or after a time."""

    trials: float = float("inf")
    seconds: float = float("inf")

    @classmethod
    def parse(cls, text: str) -> "Budget":
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
    """A search over the space of a template.

    Parameters
    ----------
    folder : Path
        Where the study is stored. An existing study is resumed.
    template : Template
    setting : Setting
    objective : Objective
    controls : Path
        Folder of the runs without an attack; searches of the same setting may share it.
    blocks : int
        Number of blocks that trials alternate over.
    seed : int
        Of the proposals.
    sampler : str
        Name of the sampler: see `assets.search.samplers`.
    """

    def __init__(
        self,
        folder: Path,
        template: Template,
        setting: Setting,
        objective: Objective,
        *,
        controls: Path,
        blocks: int,
        seed: int = 0,
        sampler: Sampler = "tpe",
    ) -> None:
        self._template, self._blocks = template, blocks
        self._setting, self._objective, self._controls = setting, objective, controls
        folder.mkdir(parents=True, exist_ok=True)
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        storage = JournalStorage(JournalFileBackend(str(folder / JOURNAL)))
        name = f"{template.id} {','.join(objective.directions)}"
        try:
            self._study = optuna.create_study(
                storage=storage, study_name=name, directions=objective.directions,
                load_if_exists=True,
            )  # fmt: skip
        except ValueError as error:
            raise SearchError(
                f"{folder} has another search: {error}; choose another folder."
            ) from error
        # After resuming, proposals must not repeat.
        fresh = seed + len(self._study.trials)
        self._study.sampler = sampler_for(sampler, fresh)

    @property
    def findings(self) -> list[Finding]:
        """The findings of all trials, in the order of their numbers."""
        documents = [trial.user_attrs.get(_FINDING) for trial in self._study.trials]
        return [_from_dict(document) for document in documents if document]

    @property
    def front(self) -> list[Finding]:
        """The findings on the Pareto front."""
        return [_from_dict(trial.user_attrs[_FINDING]) for trial in self._study.best_trials]

    def run(self, budget: Budget, workers: int, failed: Callable[[str], None]) -> Iterator[Finding]:
        """Yield the findings of trials as they arrive, until the budget is used up.

        Parameters
        ----------
        budget : Budget
        workers : int
            Number of parallel trials.
        failed : callable
            Called with the reason for each failed trial.
        """
        controls = self._controls
        for outcome in fan_out(
            partial(run_control, self._setting, controls),
            range(self._blocks),
            partial(process_pool, workers),
        ):
            if outcome.error is not None:
                raise SearchError(f"Block {outcome.job} cannot be run: {outcome.error}")
        executor = process_pool(workers)
        ends = time.monotonic() + budget.seconds
        try:
            while len(self._study.trials) < budget.trials and time.monotonic() < ends:
                size = min(workers, budget.trials - len(self._study.trials))
                trials = [self._study.ask() for _ in range(int(size))]
                running = [
                    (
                        trial,
                        executor.submit(run_trial, self._setting, controls, self._proposal(trial)),
                    )
                    for trial in trials
                ]
                for trial, future in running:
                    error = future.exception()
                    if error is None:
                        yield self._report(trial, future.result())
                    else:
                        self._study.tell(trial, state=optuna.trial.TrialState.FAIL)
                        failed(f"trial {trial.number}: {error}")
        finally:
            executor.shutdown(cancel_futures=True)

    def _proposal(self, trial: optuna.Trial) -> Proposal:
        attack = self._template.suggest(trial)
        block = trial.number % self._blocks
        return Proposal(trial.number, block, attack.document, attack.values)

    def _report(self, trial: optuna.Trial, finding: Finding) -> Finding:
        trial.set_user_attr(_FINDING, dataclasses.asdict(finding))
        trial.set_user_attr(MOVED, finding.moved)
        if self._objective.wants_detected:
            trial.set_constraint("p-value over rate", finding.p_value - self._setting.far)
        self._study.tell(trial, self._objective.values(finding, self._setting.far))
        return finding


def _from_dict(document: Mapping[str, Any]) -> Finding:
    lists = {name: tuple(document[name]) for name in ("families", "moved", "violated")}
    return Finding(**{**document, **lists, "proposal": Proposal(**document["proposal"])})
