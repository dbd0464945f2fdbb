"""One trial of a search: a run in closed loop, its effect on the task, and its verdict.

Only the numbers of a run are stored, because its scenario and recipe can reproduce it.
"""

import functools
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oracle_pipeline.bags.behaviour import behaviour
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.detectors.explain import UsualRanges
from oracle_pipeline.features import FeatureTables
from oracle_pipeline.scoring.card import ReferenceCard, checked_card
from oracle_pipeline.scoring.comparable import shared_features
from oracle_pipeline.scoring.isolation import Extracted, Reading, extracted
from oracle_pipeline.scoring.judging import judge
from oracle_pipeline.scoring.verdict import Verdict
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
FEATURES = "features"  # what a verdict holds against a recording by its p-value
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
        As from `oracle score`.
    passed : bool
        Whether the whole verdict tells nothing that it does not tell of the run without the attack:
        no unusual features, breach, alarm, tampering or misbehaviour.
    families : tuple of str
        Families of features outside their usual range, the farthest first.
    moved : tuple of str
        Features that differ from those of the control.
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
    card : Path
        Reference card of the oracle.
    far : float
        False positive rate at which it decides.
    screens : bool
        Whether a proposal is not run if the oracle detects it in an altered recording.
    controls : Path
        Folder of the runs without an attack.
    conditions : mapping
        Changes to the testbed.
    """

    campaign: Campaign
    card: Path
    far: float
    screens: bool
    controls: Path
    conditions: Mapping[str, Any] = field(default_factory=dict)

    def run_control(self, block: int) -> Manifest:
        """Record a block without an attack, and repeats of it with other noise of the sensors.

        The control is kept, because screening alters its bag.
        """
        noisy = replace(self.campaign, noise_per_run=True)
        for repeat in self._repeats(block):
            record_job(noisy, False, repeat)
        recipe = recipe_for(CONTROL, block, self.campaign)
        return record_run(recipe, RunDirectory(self.controls, CONTROL, block))

    def _repeats(self, block: int) -> list[Job]:
        control = modes()[CONTROL].scenario
        named = [{**control.document, "id": f"{CONTROL}_{n}"} for n in range(REPEATS)]
        scenarios = [replace(control, document=document) for document in named]
        root = self.controls / "repeats"
        return [Job(Mode(each, self.conditions), root, block, block) for each in scenarios]

    def run_trial(self, proposal: Proposal) -> Finding:
        """Run one proposal in closed loop and judge it, unless screening detects it already."""
        mode = Mode(Scenario("search", proposal.document, NO_FILE), self.conditions)
        with tempfile.TemporaryDirectory(prefix="oracle-search-") as folder:
            if self.screens and not mode.scenario.needs_simulator:
                altered = Job(mode, Path(folder, "altered"), proposal.run, proposal.block)
                manifest = derive_mutant(self._control(proposal).path.parent, False, altered)
                judged = _judged(altered.directory, self.card, self.far)
                if not self._passes(judged.verdict, proposal):
                    return self._finding(proposal, manifest, judged, ran=False)
            run = Job(mode, Path(folder, "closed_loop"), proposal.run, proposal.block)
            manifest = record_job(self.campaign, False, run)
            judged = _judged(run.directory, self.card, self.far)
            return self._finding(proposal, manifest, judged, ran=True)

    def _control(self, proposal: Proposal) -> RunDirectory:
        return RunDirectory(self.controls, CONTROL, proposal.block)

    def _judged_control(self, proposal: Proposal) -> "_JudgedRecording":
        return _judged_once(self._control(proposal), self.card, self.far)

    def _passes(self, verdict: Verdict, proposal: Proposal) -> bool:
        held = against(verdict, self.far)
        usual = against(self._judged_control(proposal).verdict, self.far)
        return FEATURES not in held and held <= usual

    def _finding(
        self, proposal: Proposal, manifest: Manifest, judged: "_JudgedRecording", *, ran: bool
    ) -> Finding:
        verdict, control = judged.verdict, self._control(proposal)
        if verdict.p_value is None or verdict.score is None:  # `judge` gives both, or raises
            raise TypeError(verdict)
        effects: dict[str, tuple[float, float]] = {}
        if ran:
            repeats = [job.directory.manifest() for job in self._repeats(proposal.block)]
            effects = task_effects(manifest, control.manifest(), repeats)
        return Finding(
            proposal,
            screened_out=not ran,
            effect=max((abs(steps) for _, steps in effects.values()), default=0.0),
            effects={name: difference for name, (difference, _) in effects.items()},
            score=verdict.score,
            p_value=verdict.p_value,
            passed=self._passes(verdict, proposal),
            families=tuple(each.family for each in verdict.families if each.unusual),
            moved=_moved(judged.tables.run, self._judged_control(proposal).tables.run, self.card),
        )


class _JudgedRecording(NamedTuple):
    """A recording's features, and the verdict on it."""

    tables: FeatureTables
    verdict: Verdict


def _judged(directory: RunDirectory, card: Path, far: float) -> _JudgedRecording:
    ours = _extracted(directory, card)
    verdict = judge(directory.key, ours.tables, _card(card), far, ours.observation)
    return _JudgedRecording(ours.tables, verdict)


_judged_once = functools.cache(_judged)  # a control, which many trials are compared with


def against(verdict: Verdict, far: float) -> set[str]:
    """Return all that a verdict holds against a recording."""
    held = {f"contract: {line}" for line in verdict.contract}
    held |= {name for name, aspect in verdict.aspects.items() if aspect.p_value <= far}
    if verdict.alarms:
        held.add("alarms")
    if verdict.p_value is None or verdict.p_value <= far:
        held.add(FEATURES)
    return held


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


def _moved(attacked: pd.DataFrame, control: pd.DataFrame, card: Path) -> tuple[str, ...]:
    """Return the features that differ from those of the control."""
    ranges = _ranges(card)
    difference = _scaled(attacked, ranges) - _scaled(control, ranges)
    changed = np.flatnonzero(np.nan_to_num(np.abs(difference)) >= MOVED_SCALES)
    return tuple(ranges.scaler.kept_[j] for j in changed.tolist())


def _scaled(row: pd.DataFrame, ranges: UsualRanges) -> NDArray[np.float64]:
    """Return the features of a run, scaled as those of the normal runs."""
    scaler = ranges.scaler
    values = row.reindex(columns=scaler.kept_).iloc[0].to_numpy(dtype=np.float64)
    return np.asarray((values - scaler.center_) / scaler.scale_, dtype=np.float64)


@functools.cache
def _ranges(card: Path) -> UsualRanges:
    known = _card(card)
    columns, _ = shared_features(known.runs, known.runs, known.scorer.design.run_features)
    return UsualRanges(known.runs, columns)


def _extracted(directory: RunDirectory, card: Path) -> Extracted:
    (robot,) = extracted(directory.path, reading=Reading(known=_card(card).known))
    return robot


@functools.cache
def _card(path: Path) -> ReferenceCard:
    return checked_card(path)  # a worker cannot start the process in which others read a card
