"""One trial of a search: a run in closed loop, its effect on the task, and its verdict.

Only the numbers of a run are stored, because its scenario and recipe can reproduce it.
"""

import functools
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from assets.search.feedback import FEEDBACKS
from assets.search.oracles import FEATURES, Judgement, SearchOracle
from oracle_pipeline.bags.behaviour import behaviour
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.oracles.collecting import traced_run
from sim.campaigns import Campaign
from sim.commands.kill_matrix import derive_mutant
from sim.experiments import Job, recipe_for, record_job, record_run
from sim.fuzzing.scenario import NO_FILE, Scenario
from sim.modes import modes
from sim.pairs import CONTROL
from sim.testbed import Mode

REPEATS = 4  # of each block, with other noise
SHARE = 0.15  # relative change of the control's path or time that is an effect on the task
# Smallest difference of other quantities that is an effect.
STEPS: Mapping[str, float] = {
    "clearance_m": 0.05, "goals_reached": 1.0, "recoveries": 1.0, "commands_altered": 0.05,
}  # fmt: skip
MOVED_SCALES = 3.0  # difference from the control from which a feature counts as changed


@dataclass(frozen=True, slots=True)
class Proposal:
    """The run that one trial proposes.

    Attributes
    ----------
    document : mapping
        The scenario, with the values as defaults.
    values : mapping of str to number or text
        The proposed values, by name.
    """

    run: int
    block: int
    document: Mapping[str, Any]
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one trial.

    Attributes
    ----------
    screened_out : bool
        Whether the oracle detects the attack in an altered recording of the control. Then it was
        not run in closed loop and has no effect.
    effect : float
        Largest change of the task beyond repeats with other noise, in units of a change that
        matters: 1 or more is an effect.
    effects : mapping of str to float
        Attacked run minus control, in the unit of each quantity.
    score, p_value : float
        Of the oracle; for a card as from `oracle score`.
    passed : bool
        Whether the oracle tells nothing that it does not tell of the run without the attack. For a
        card: no unusual features, breach, alarm, tampering or misbehaviour.
    families : tuple of str
        Families of features outside their usual range, the farthest first.
    moved : tuple of str
        Features that differ from those of the control.
    feedback : float, optional
        What guides the search instead of the effect: attacked run minus control.
    """

    proposal: Proposal
    screened_out: bool
    effect: float
    effects: Mapping[str, float]
    score: float
    p_value: float
    passed: bool
    families: tuple[str, ...]
    moved: tuple[str, ...]
    feedback: float | None = None

    @property
    def has_effect(self) -> bool:
        """Whether the attack changed the robot's task significantly."""
        return self.effect >= 1.0

    @property
    def is_miss(self) -> bool:
        """Whether the run had an effect that the oracle misses."""
        return self.has_effect and self.passed


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """Runs the proposals of a search and judges them.

    Attributes
    ----------
    campaign : Campaign
        Settings of all runs.
    oracle : SearchOracle
        Judges the runs.
    screens : bool
        Whether a proposal is not run if the oracle detects it in an altered recording.
    controls : Path
        Folder of the runs without an attack.
    conditions : mapping
        Changes to the testbed.
    feedback : str, optional
        Name in `FEEDBACKS` of what guides the search instead of the effect.
    control : str
        Mode of the runs without an attack.
    """

    campaign: Campaign
    oracle: SearchOracle
    screens: bool
    controls: Path
    conditions: Mapping[str, Any] = field(default_factory=dict)
    feedback: str | None = None
    control: str = CONTROL

    def run_control(self, block: int) -> Manifest:
        """Record a block without an attack, and repeats of it with other noise of the sensors.

        The control is kept, because screening alters its bag.
        """
        noisy = replace(self.campaign, noise_per_run=True)
        for repeat in self._repeats(block):
            record_job(noisy, False, repeat)
        recipe = recipe_for(self.control, block, self.campaign)
        return record_run(recipe, RunDirectory(self.controls, self.control, block))

    def _repeats(self, block: int) -> list[Job]:
        control = modes()[self.control].scenario
        named = [{**control.document, "id": f"{control.id}_{n}"} for n in range(REPEATS)]
        scenarios = [replace(control, document=document) for document in named]
        root = self.controls / "repeats"
        return [Job(Mode(each, self.conditions), root, block, block) for each in scenarios]

    def run_trial(self, proposal: Proposal) -> Finding:
        """Run one proposal in closed loop and judge it, unless screening detects it already."""
        mode = Mode(Scenario("search", proposal.document, NO_FILE), self.conditions)
        with tempfile.TemporaryDirectory(prefix="oracle-search-") as folder:
            if self.screens and not mode.scenario.needs_simulator:
                altered = Job(mode, Path(folder, "altered"), proposal.run, proposal.block)
                derive_mutant(self._control(proposal).path.parent, False, altered)
                judged = self.oracle.judge(altered.directory)
                if not self._passes(judged, proposal):
                    return self._finding(proposal, altered.directory, judged, ran=False)
            run = Job(mode, Path(folder, "closed_loop"), proposal.run, proposal.block)
            record_job(self.campaign, False, run)
            judged = self.oracle.judge(run.directory)
            return self._finding(proposal, run.directory, judged, ran=True)

    def _control(self, proposal: Proposal) -> RunDirectory:
        return RunDirectory(self.controls, self.control, proposal.block)

    def judged_control(self, proposal: Proposal) -> Judgement:
        """Judge the run without the attack, once."""
        return _judged_once(self.oracle, self._control(proposal))

    def _passes(self, judged: Judgement, proposal: Proposal) -> bool:
        return FEATURES not in judged.held and judged.held <= self.judged_control(proposal).held

    def _finding(
        self, proposal: Proposal, run: RunDirectory, judged: Judgement, *, ran: bool
    ) -> Finding:
        control = self._control(proposal)
        effects: dict[str, tuple[float, float]] = {}
        if ran:
            repeats = [job.directory.manifest() for job in self._repeats(proposal.block)]
            effects = task_effects(run.manifest(), control.manifest(), repeats)
        feedback = None
        if self.feedback is not None:
            usual = _feedback_once(self.feedback, control)
            feedback = _feedback(self.feedback, run) - usual if ran else 0.0
        return Finding(
            proposal,
            screened_out=not ran,
            effect=max((abs(steps) for _, steps in effects.values()), default=0.0),
            effects={name: difference for name, (difference, _) in effects.items()},
            score=judged.score,
            p_value=judged.p_value,
            passed=self._passes(judged, proposal),
            families=judged.families,
            moved=_moved(judged.features, self.judged_control(proposal).features),
            feedback=feedback,
        )


@functools.cache
def _judged_once(oracle: SearchOracle, run: RunDirectory) -> Judgement:
    """Judge a control, which many trials are compared with."""
    return oracle.judge(run)


def task_effects(
    attacked: Manifest, control: Manifest, repeats: Sequence[Manifest] = ()
) -> dict[str, tuple[float, float]]:
    """Return the change of each quantity in its own unit, and how far it is beyond all repeats.

    The latter is in units of a change that matters. A tiny change of a message may send the robot
    another way, as other noise of its sensors does; that is no effect of the attack.
    """
    ours, theirs = behaviour(attacked), behaviour(control)
    usual = [theirs, *map(behaviour, repeats)]
    effects = {}
    for name in ours.keys() & theirs.keys():
        reached = [each[name] for each in usual if name in each]
        beyond = ours[name] - min(max(ours[name], min(reached)), max(reached))
        step = STEPS.get(name, SHARE * max(abs(theirs[name]), 1e-9))
        effects[name] = (ours[name] - theirs[name], beyond / step)
    return dict(sorted(effects.items()))


def _moved(attacked: Mapping[str, float], control: Mapping[str, float]) -> tuple[str, ...]:
    """Return the features that differ from those of the control."""
    return tuple(
        name for name, value in attacked.items() if abs(value - control[name]) >= MOVED_SCALES
    )


@functools.cache
def _feedback_once(name: str, run: RunDirectory) -> float:
    return _feedback(name, run)


def _feedback(name: str, run: RunDirectory) -> float:
    return FEEDBACKS[name](traced_run(run).traces[0], run.manifest())
