"""Searches for attacks that the oracle misses, with a partition for each variable scenario.

This is an external asset, as in ``assets.foreign_recordings``: the job ``search_attacks`` reports
its events. So ``--select '*'`` still means the whole campaign, and no search delays it.
"""

from collections.abc import Iterator
from typing import Literal

import dagster as dg
from pydantic import Field

from assets import presentation
from assets.asset_defaults import declared
from assets.worker.versions import analysis_code
from oracle_pipeline.bags import layout
from resources.campaign import CampaignSettings
from resources.failures import clear_failures
from resources.fleet import Fleet
from resources.inbox import Inbox
from resources.store import RunStore
from sim.fuzzing.scenario import Scenario
from sim.modes import modes
from sim.scenarios import builtin_scenarios
from sim.testbeds import TESTBEDS, which_testbed


def can_be_varied(scenario: Scenario) -> bool:
    """Return whether a scenario is an attack on the robot with bounded numbers to vary."""
    parameters = scenario.document.get("parameters", {}).values()
    return (
        scenario.label == "malicious"
        and which_testbed(scenario) == next(iter(TESTBEDS))
        and not scenario.may_move
        and any("min" in each and "max" in each and "drawn" not in each for each in parameters)
    )


TEMPLATES = dg.StaticPartitionsDefinition(
    [
        name
        for name, scenario in {
            **builtin_scenarios(),
            **{mode.id: mode.scenario for mode in modes().values()},
        }.items()
        if can_be_varied(scenario)
    ]
)
ATTACK_SEARCH = dg.AssetSpec(
    "attack_search",
    **declared("scenario", "searches/<scenario>/findings.json"),
    group_name="search",
    kinds={"optuna", "mujoco"},
    code_version=analysis_code("assets.search.search"),
    partitions_def=TEMPLATES,
    description="""The results of a search over the parameters of a scenario.

`<root>/searches/<scenario>/findings.json` and `front.png`. Each run with an effect that the oracle
misses becomes a scenario in `<root>/searches/corpus`; set `ORACLE_SCENARIOS` to that folder to use
these as modes. The job `search_attacks` runs the search with the card `ORACLE_CARD`, as
`oracle-sim search SCENARIO --reference CARD` does.""",
)


class SearchConfig(dg.Config):
    """The budget and the objective of a search."""

    budget: str = Field(
        default="100",
        description="When to end: a number of trials in total, or a time such as 30m.",
    )
    objective: Literal["evade", "break", "boundary"] = Field(
        default="evade", description="Objective of the search: evade, break or boundary."
    )
    sampler: Literal["tpe", "nsga2", "random"] = Field(
        default="tpe", description="How trials are proposed: tpe, nsga2 or random."
    )
    blocks: int = Field(default=3, ge=1, description="Number of blocks that trials alternate over.")
    goals: int = Field(default=1, ge=1, description="Goals of each run.")
    time_limit: float = Field(
        default=120.0, gt=0.0, description="Simulated seconds that a goal may take, on average."
    )
    far: float = Field(
        default=0.05,
        gt=0.0,
        lt=1.0,
        description="False positive rate at which the oracle decides.",
    )


@dg.op
def search_scenario(
    context: dg.OpExecutionContext,
    config: SearchConfig,
    store: RunStore,
    fleet: Fleet,
    campaign: CampaignSettings,
    inbox: Inbox,
) -> Iterator[dg.AssetMaterialization | dg.Output[None]]:
    """Search the scenario of the partition; an existing search is continued."""
    from assets.search.outcome import PICTURE, save
    from assets.search.search import CONTROLS, Search, SearchSettings, TrialBudget, attacks

    name = context.partition_key
    store.require_writable()
    folder = layout.search(store.path, name)
    with clear_failures():
        settings = SearchSettings(
            card=inbox.card_path,
            campaign=campaign.campaign(),
            **config.model_dump(exclude={"budget"}),
        )
        controls, budget = folder / CONTROLS, TrialBudget.parse(config.budget)
        space = attacks(name, controls, settings)
        search = Search(folder, space, settings, controls, settings.campaign.seed)
        for finding in search.run(budget, fleet.workers, context.log.warning):
            if finding.is_miss:
                context.log.info(f"Miss: trial {finding.proposal.run}, effect {finding.effect:.2g}")
        findings, corpus = search.findings, layout.search_corpus(store.path)
        files = save(folder, findings, search.front, config.far, corpus)
    yield dg.AssetMaterialization(
        ATTACK_SEARCH.key,
        partition=name,
        metadata={
            "path": dg.MetadataValue.path(str(folder)),
            "trials": len(findings),
            "run_in_closed_loop": sum(not each.screened_out for each in findings),
            "misses": len(files),
            "largest_effect": max((each.effect for each in findings), default=0.0),
            **presentation.pictures({"front": (folder / PICTURE).read_bytes()}),
        },
        tags={"dagster/code_version": str(ATTACK_SEARCH.code_version)},
    )
    yield dg.Output(None)


@dg.job(
    partitions_def=TEMPLATES,
    description="Search one scenario's parameters for attacks that the oracle misses, with the "
    "reference card `ORACLE_CARD`. Start it again with a larger budget to continue.",
)
def search_attacks() -> None:
    """Search one scenario."""
    search_scenario()
