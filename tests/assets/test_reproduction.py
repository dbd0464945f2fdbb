"""A re-simulated run: the result of the check, and which run stays in use."""

import json
import shutil
from typing import Any

import dagster as dg
import pytest

from assets.experiment_runs import REPRODUCIBLE
from assets.worker.reproduction import refreshed_directory
from oracle_pipeline.bags.run_directory import find_runs
from tests.assets.laboratory import KEYS, PER_RUN, Laboratory
from tests.manifests import rewrite

pytestmark = pytest.mark.slow

BOTH = KEYS[2:]  # runs of the attacked mode


def refreshed(laboratory: Laboratory, first: str, last: str) -> dg.ExecuteInProcessResult:
    """Re-simulate a range of runs, without the assets over all runs."""
    return laboratory.materialize(PER_RUN, first, last, config={"runs": {"refresh": True}})


def results(outcome: dg.ExecuteInProcessResult) -> dict[str | None, dg.AssetCheckEvaluation]:
    """The results of the check in one Dagster run, by partition."""
    return {
        evaluation.partition: evaluation
        for evaluation in outcome.get_asset_check_evaluations()
        if evaluation.check_name == REPRODUCIBLE.name
    }


def recorded(laboratory: Laboratory) -> dict[str, tuple[int, int]]:
    """The files of the runs that are in use."""
    return {path: as_of for path, as_of in laboratory.files().items() if path.startswith("runs/")}


def test_an_equal_re_simulation_passes_and_a_verified_run_gives_no_result(
    copy_of_campaign: Laboratory,
) -> None:
    run = copy_of_campaign.store.run(BOTH[0])
    before, hash_before = copy_of_campaign.files(), run.manifest().content_hash
    found = results(refreshed(copy_of_campaign, run.key, run.key))
    assert found.keys() == {run.key}
    result = found[run.key]
    assert result.passed
    assert result.metadata["former_hash"].value == result.metadata["new_hash"].value == hash_before
    assert result.target_materialization_data is not None
    assert {copy_of_campaign.figures(asset, run.key)["status"] for asset in PER_RUN} == {"made"}
    after = copy_of_campaign.files()
    changed = {path for path in after if after[path] != before.get(path)}
    of_run = {path for path in after if f"/{run.mode}/{run.run_id}" in path}
    assert changed == {path for path in of_run if not path.startswith("report/")}
    assert run.manifest().content_hash == hash_before
    assert not refreshed_directory(run).path.exists()
    verified = copy_of_campaign.materialize(PER_RUN, run.key)
    assert verified.success
    assert results(verified) == {}


def test_other_software_or_recipe_explains_different_messages_and_the_run_is_replaced(
    copy_of_campaign: Laboratory,
) -> None:
    of_software, of_recipe = (copy_of_campaign.store.run(key) for key in BOTH)
    hashes = {run.key: run.manifest().content_hash for run in (of_software, of_recipe)}

    def other_software(document: dict[str, Any]) -> None:
        document["software"]["code"] = "of last year"
        document["content_hash"] = "0" * 64

    def other_recipe(document: dict[str, Any]) -> None:  # as when a scenario file has changed
        document["recipe"]["scenario"]["title"] = "What it was called last year"
        document["content_hash"] = "1" * 64

    rewrite(of_software, other_software)
    rewrite(of_recipe, other_recipe)
    found = results(refreshed(copy_of_campaign, *BOTH))
    for run, what in ((of_software, "code"), (of_recipe, "recipe")):
        assert found[run.key].passed
        assert what in str(found[run.key].description)
        assert found[run.key].metadata["new_hash"].value == hashes[run.key]
        assert run.manifest().content_hash == hashes[run.key]
        assert not refreshed_directory(run).path.exists()


def test_an_unexplained_difference_fails_and_both_runs_are_kept(
    copy_of_campaign: Laboratory,
) -> None:
    run, other = (copy_of_campaign.store.run(key) for key in BOTH)
    right, wrong = run.manifest().content_hash, other.manifest().content_hash
    own = json.loads(run.manifest_path.read_text(encoding="utf-8"))
    shutil.rmtree(run.path)
    shutil.copytree(other.path, run.path)
    who = ("run", "block", "session", "recipe")
    rewrite(run, lambda document: document.update({name: own[name] for name in who}))
    before = recorded(copy_of_campaign)

    outcome = refreshed(copy_of_campaign, BOTH[0], BOTH[0])
    assert outcome.success  # only the check fails
    result = results(outcome)[run.key]
    assert not result.passed
    aside = refreshed_directory(run)
    assert {name: value.value for name, value in result.metadata.items()} == {
        "former_hash": wrong,
        "new_hash": right,
        "former_path": str(run.path),
        "new_path": str(aside.path),
    }
    assert aside.manifest().content_hash == right
    assert recorded(copy_of_campaign) == before
    assert len(find_runs(copy_of_campaign.store.path)) == len(KEYS)

    rewrite(run, lambda document: document.update(content_hash=right))  # as if it were explained
    assert results(refreshed(copy_of_campaign, BOTH[0], BOTH[0]))[run.key].passed
    assert not aside.path.exists()
