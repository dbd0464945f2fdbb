"""Builds a search from settings: over a scenario's parameters, or over topics and operators."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from assets.search.attacks import ComposedTemplate, ScenarioTemplate, Template
from assets.search.closed_loop import Setting, run_control
from assets.search.objectives import OBJECTIVES
from assets.search.samplers import Sampler, sampler_named
from assets.search.space import SearchError, search_space
from assets.search.study import Search
from sim.campaigns import Campaign
from sim.modes import find_mode

CONTROLS = "controls"  # folder of the runs without an attack, in that of the search


@dataclass(frozen=True, slots=True)
class Plan:
    """The settings of a search.

    Attributes
    ----------
    card : Path
        Reference card of the oracle to search against.
    campaign : Campaign
        Settings of all runs, except goals and time limit.
    goals : int
        Of each run.
    time_limit : float
        Simulated seconds that a goal may take, on average.
    far : float
        False positive rate at which the oracle decides.
    """

    card: Path
    campaign: Campaign
    objective: str = "evade"
    sampler: str = "tpe"
    blocks: int = 3
    goals: int = 1
    time_limit: float = 120.0
    far: float = 0.05
    screen: bool = True
    allow_actuation: bool = False
    ranges: tuple[str, ...] = ()  # NAME=LOW:HIGH, of a scenario's parameters
    topics: tuple[str, ...] = ()  # without a scenario
    operators: tuple[str, ...] = ()

    @property
    def setting(self) -> Setting:
        """The settings that all trials share.

        Raises
        ------
        SearchError
            The objective does not exist.
        """
        if self.objective not in OBJECTIVES:
            raise SearchError(
                f"There is no objective {self.objective}; there are {', '.join(OBJECTIVES)}."
            )
        campaign = dataclasses.replace(
            self.campaign, goals_per_run=self.goals, timeout_s=self.time_limit * self.goals
        )
        screen = self.screen and OBJECTIVES[self.objective].screens
        return Setting(campaign, self.card, self.far, screen)


def template_of(name: str | None, folder: Path, plan: Plan) -> Template:
    """Return the template of a search: a scenario, or topics and operators if `name` is None."""
    if name is not None:
        mode = find_mode(name, allow_actuation=plan.allow_actuation)
        return ScenarioTemplate(mode, search_space(mode, plan.ranges))
    control = run_control(plan.setting, folder / CONTROLS, 0)
    available = {topic: count.type for topic, count in control.topics.items()}
    return ComposedTemplate.of(
        plan.topics, plan.operators, available, allow_actuation=plan.allow_actuation
    )


def search_of(
    template: str | Template,
    folder: Path,
    plan: Plan,
    *,
    controls: Path | None = None,
    seed: int | None = None,
    sampler: Sampler | None = None,
) -> Search:
    """Return the search in a folder; an existing search is resumed.

    Parameters
    ----------
    template
        The template, or the name of a scenario.
    folder
        Of the search.
    plan
        The settings.
    controls
        Folder of the runs without an attack; by default inside that of the search.
    seed, sampler
        Override those of campaign and plan.

    Raises
    ------
    OracleError
        A name in the plan does not exist.
    """
    if isinstance(template, str):
        template = template_of(template, folder, plan)
    return Search(
        folder,
        template,
        dataclasses.replace(plan.setting, conditions=template.conditions),
        OBJECTIVES[plan.objective],
        controls=controls or folder / CONTROLS,
        blocks=plan.blocks,
        seed=plan.campaign.seed if seed is None else seed,
        sampler=sampler or sampler_named(plan.sampler),
    )
