"""The testbed of a scenario, a recipe or a run."""

from dataclasses import replace
from pathlib import Path

import pytest

from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign
from sim.experiments import recipe_for, recipe_of, record_run
from sim.modes import modes
from sim.testbeds import TESTBEDS, which_testbed

SHORT = Campaign(goals_per_run=1, timeout_s=3.0)


def mode_of(testbed):
    """Return the first experiment of a testbed."""
    return modes()[TESTBEDS[testbed].experiments[0]]


def test_every_experiment_is_run_on_the_testbed_that_names_it():
    for name, testbed in TESTBEDS.items():
        named = [*testbed.experiments, *testbed.hard_negatives]
        assert {which_testbed(modes()[mode].scenario) for mode in named} == {name}


def test_a_scenario_on_a_type_of_no_testbed_runs_on_the_first():
    scenario = mode_of("atc").scenario
    main = {**scenario.document["main"], "type": "sensor_msgs/msg/Imu"}
    assert which_testbed(replace(scenario, document={**scenario.document, "main": main})) == (
        next(iter(TESTBEDS))
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", TESTBEDS)
def test_a_recorded_recipe_is_that_of_one_testbed_and_comes_back(name, tmp_path):
    recipe = recipe_for(mode_of(name), 0, SHORT)
    manifest = record_run(recipe, RunDirectory(tmp_path, mode_of(name).id, 0))
    assert [bed for bed, testbed in TESTBEDS.items() if testbed.made(manifest.recipe)] == [name]
    assert recipe_of(manifest) == recipe
    of_it = recipe.campaign()
    assert of_it == replace(SHORT, goals_per_run=of_it.goals_per_run, session=0)


@pytest.mark.slow
@pytest.mark.parametrize("name", TESTBEDS)
def test_the_hash_of_a_run_covers_the_module_that_executes_it(name, tmp_path):
    testbed = TESTBEDS[name]
    run = testbed.bring_up(recipe_for(mode_of(name), 0, SHORT), Path(tmp_path))
    assert type(run).__module__ == testbed.made_by
