"""One trial of a search: a run in closed loop, what it did to the task, and its verdict.

Nothing of a run stays but numbers: its recipe makes it again.
"""

import functools
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oracle_pipeline.bags.behaviour import behaviour
from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.features import build_manager, extract
from oracle_pipeline.opened_run import open_run
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.contract import Observation
from oracle_pipeline.scoring.judging import judge
from oracle_pipeline.scoring.verdict import Verdict
from sim.campaigns import Campaign
from sim.commands.kill_matrix import Job, derive_mutant, record_mutant
from sim.experiments import recipe_for, record_run
from sim.pairs import CONTROL
from sim.testbed import Mode

SHARE = 0.15  # of the control's way or time: so much more or less is an effect on the task
# Of each other quantity, the difference that is an effect.
STEPS: Mapping[str, float] = {
    "clearance_m": 0.05,
    "goals_reached": 1.0,
    "recoveries": 1.0,
    "commands_altered": 0.05,
}


@dataclass(frozen=True, slots=True)
class Setting:
    """What all trials of a search share."""

    mode: Mode
    campaign: Campaign
    card: Path
    far: float
    screen: bool


@dataclass(frozen=True, slots=True)
class Proposal:
    """What one trial is to run."""

    run: int
    block: int
    given: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Finding:
    """What one trial showed.

    Attributes
    ----------
    screened_out : bool
        The oracle detects the attack already if it only alters the recording of the control, so
        it was not run in closed loop and has no effect.
    effect : float
        Largest change of the task, in steps that matter: 1 or more is an effect.
    effects : mapping of str to float
        Attacked less control, in the unit of each quantity.
    magnitude : float or None
        Largest change of a message, in the unit of what the scenario changes; None if a number was
        no longer finite.
    score, p_value : float
        Of `oracle score`.
    families : tuple of str
        Families of features outside their usual range, the farthest first.
    """

    proposal: Proposal
    screened_out: bool
    effect: float
    effects: Mapping[str, float]
    magnitude: float | None
    score: float
    p_value: float
    families: tuple[str, ...]

    @property
    def has_effect(self) -> bool:
        """Whether the robot did its task otherwise."""
        return self.effect >= 1.0


def run_control(setting: Setting, root: Path, block: int) -> Manifest:
    """Record a block without an attack, below a root where it stays: screening alters its bag."""
    recipe = recipe_for(CONTROL, block, setting.campaign)
    return record_run(recipe, RunDirectory(root, CONTROL, block))


def run_trial(setting: Setting, controls: Path, proposal: Proposal) -> Finding:
    """Run one proposal in closed loop and judge it, unless its messages alone give it away."""
    control = RunDirectory(controls, CONTROL, proposal.block)
    with tempfile.TemporaryDirectory(prefix="oracle-search-") as folder:
        root = Path(folder)
        if setting.screen:
            altered = Job(setting.mode, root / "altered", proposal)
            manifest = derive_mutant(control.path.parent, False, altered)
            verdict = _judged(setting, altered.directory)
            if verdict.outcome == "anomalous":
                return _finding(proposal, manifest, verdict, {}, screened_out=True)
        run = Job(setting.mode, root / "closed_loop", proposal)
        manifest = record_mutant(setting.campaign, False, run)
        effects = task_effects(manifest, control.manifest())
        return _finding(proposal, manifest, _judged(setting, run.directory), effects)


def task_effects(attacked: Manifest, control: Manifest) -> dict[str, tuple[float, float]]:
    """Return of each quantity how much more the attacked run has, and that in steps that matter."""
    ours, theirs = behaviour(attacked), behaviour(control)
    effects = {}
    for name in ours.keys() & theirs.keys():
        difference = ours[name] - theirs[name]
        step = STEPS.get(name, SHARE * max(abs(theirs[name]), 1e-9))
        effects[name] = (difference, difference / step)
    return dict(sorted(effects.items()))


def _finding(
    proposal: Proposal,
    manifest: Manifest,
    verdict: Verdict,
    effects: Mapping[str, tuple[float, float]],
    *,
    screened_out: bool = False,
) -> Finding:
    if verdict.p_value is None or verdict.score is None:  # `judge` gives both, or raises
        raise TypeError(verdict)
    largest = [change.largest for change in manifest.changes]
    return Finding(
        proposal,
        screened_out=screened_out,
        effect=max((abs(steps) for _, steps in effects.values()), default=0.0),
        effects={name: difference for name, (difference, _) in effects.items()},
        magnitude=None if None in largest else max(filter(None, largest), default=0.0),
        score=verdict.score,
        p_value=verdict.p_value,
        families=tuple(each.family for each in verdict.families if each.unusual),
    )


def _judged(setting: Setting, directory: RunDirectory) -> Verdict:
    with open_run(directory.path) as run:
        tables, seen = extract(run, build_manager(None)), Observation.of(run)
    return judge(directory.key, tables, _card(setting.card), setting.far, seen)


@functools.cache
def _card(path: Path) -> ReferenceCard:
    return ReferenceCard.load(path)
