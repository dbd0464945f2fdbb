"""A run's configuration changes what it names; the environment decides the rest."""

import runpy
from dataclasses import replace

import dagster as dg

import resources.campaign
from sim.campaigns import Campaign


def test_a_configured_seed_leaves_the_other_settings_to_the_environment(monkeypatch):
    monkeypatch.setenv("ORACLE_GOALS_PER_RUN", "2")
    monkeypatch.setenv("ORACLE_NOISE_PER_RUN", "1")
    monkeypatch.setenv("ORACLE_NAV2", "drawn")
    settings = runpy.run_path(resources.campaign.__file__)["CampaignSettings"]
    seen = []

    @dg.asset
    def recorded(campaign: settings) -> None:
        seen.append(campaign.campaign())

    for config in ({"seed": 7}, {"seed": 7, "goals_per_run": 3, "noise_per_run": False}):
        dg.materialize(
            [recorded],
            resources={"campaign": settings()},
            run_config={"resources": {"campaign": {"config": config}}},
        )
    usual = replace(Campaign.from_environment(), seed=7)
    assert usual.goals_per_run == 2
    assert seen == [usual, replace(usual, goals_per_run=3, noise_per_run=False)]
