"""The five assets of a run: materialization, verification and failures."""

import base64
import re

import dagster as dg
import pytest

from oracle_pipeline.bags.run_directory import find_runs
from resources.budget import StorageBudget
from resources.campaign import CampaignSettings
from tests.assets.laboratory import ATTACKED, KEY, KEYS, PER_RUN, Laboratory
from tests.manifests import rewrite

pytestmark = pytest.mark.slow

REFRESH = {"runs": {"refresh": True}}
BOTH = KEYS[2:]  # runs of the attacked mode, first and last of a range


def test_a_range_materializes_each_run_of_each_asset_once(campaign: Laboratory) -> None:
    for asset in PER_RUN:
        records = campaign.instance.fetch_materializations(dg.AssetKey(asset), limit=100).records
        assert sorted(str(record.partition_key) for record in records) == sorted(KEYS)


def test_metadata_describes_the_run(campaign: Laboratory) -> None:
    manifest = campaign.store.run(KEY).manifest()
    run = campaign.figures("experiment_runs", KEY)
    assert (run["label"], run["outcome"]) == ("malicious", manifest.outcome)
    assert run["real_time_factor"] == pytest.approx(run["recording_s"] / run["wall_s"])
    assert campaign.figures("bags", KEY)["messages"] == sum(
        topic.messages for topic in manifest.topics.values()
    )
    graphs = campaign.figures("interval_graphs", KEY)
    assert graphs["intervals"] == round(manifest.recording_s / 10)
    assert min(graphs["nodes"], graphs["topics"], graphs["edges"]) > 0
    assert campaign.figures("run_features", KEY)["dagster/row_count"] == 1
    assert campaign.figures("window_features", KEY)["dagster/row_count"] > 1


def test_the_metadata_of_a_run_has_its_picture(campaign: Laboratory) -> None:
    for key in KEYS:
        kept = (campaign.store.run(key).path / "picture.png").read_bytes()
        start, _, encoded = campaign.figures("experiment_runs", key)["picture"].partition("base64,")
        assert start == "![](data:image/png;"
        assert base64.b64decode(encoded.removesuffix(")")) == kept
        assert kept.startswith(b"\x89PNG")
        assert len(kept) < 40_000  # a thousand of them are in the event log


def test_a_run_that_cannot_be_drawn_is_kept_with_the_reason(copy_of_campaign: Laboratory) -> None:
    picture = copy_of_campaign.store.run(KEY).path / "picture.png"
    picture.unlink()
    picture.mkdir()  # so that nothing can be written there
    assert copy_of_campaign.materialize(["experiment_runs"], KEY).success
    figures = copy_of_campaign.figures("experiment_runs", KEY)
    assert figures["status"] == "verified"
    assert re.fullmatch(r"not drawn: .*picture\.png.*", figures["picture"])


def test_data_versions_are_hashes_of_the_content(campaign: Laboratory) -> None:
    versions = {
        asset: {key: campaign.latest(asset, key).tags["dagster/data_version"] for key in KEYS}
        for asset in PER_RUN
    }
    hashes = {key: campaign.store.run(key).manifest().content_hash for key in KEYS}
    assert versions["experiment_runs"] == versions["bags"] == hashes
    for of_asset in versions.values():
        assert len(set(of_asset.values())) == len(KEYS)


def test_a_run_keeps_the_version_of_the_code_that_recorded_it(copy_of_campaign: Laboratory) -> None:
    run = copy_of_campaign.store.run(KEY)
    rewrite(run, lambda document: document["software"].update(code="of last year"))
    assert copy_of_campaign.materialize(["experiment_runs", "bags"], KEY).success
    for asset in ("experiment_runs", "bags"):
        tags = copy_of_campaign.latest(asset, KEY).tags or {}
        assert tags["dagster/code_version"] == "of last year"


def test_complete_runs_are_only_verified(copy_of_campaign: Laboratory) -> None:
    before = copy_of_campaign.files()
    assert copy_of_campaign.materialize(PER_RUN, *BOTH).success
    assert copy_of_campaign.files() == before
    for asset in PER_RUN:
        for key in BOTH:
            assert copy_of_campaign.figures(asset, key)["status"] == "verified"


def test_features_alone_are_extracted_from_the_existing_run(copy_of_campaign: Laboratory) -> None:
    copy_of_campaign.store.run(KEY).feature_table("run").unlink()
    before = copy_of_campaign.files()
    # Other goals would be another recipe; features use the existing run of any recipe.
    other = CampaignSettings(goals_per_run=2)
    assert copy_of_campaign.materialize(["run_features"], KEY, campaign=other).success
    after = copy_of_campaign.files()
    assert {path for path in after if after[path] != before.get(path)} == {
        f"features/{path}/{ATTACKED}/run000.{suffix}"
        for path, suffix in (("run", "parquet"), ("run", "json"), ("window", "parquet"))
    }
    assert copy_of_campaign.materialized("run_features") == {KEY}
    assert copy_of_campaign.materialized("window_features") == set()
    assert copy_of_campaign.materialized("bags") == set()


def test_selecting_bags_does_not_extract_features(copy_of_campaign: Laboratory) -> None:
    before = copy_of_campaign.files()
    assert copy_of_campaign.materialize(["bags"], KEY).success
    assert copy_of_campaign.files() == before
    assert copy_of_campaign.materialized("bags") == {KEY}
    assert copy_of_campaign.materialized("experiment_runs") == set()


def test_a_changed_table_is_extracted_again(copy_of_campaign: Laboratory) -> None:
    place = copy_of_campaign.store.run(KEY).feature_table("window")
    whole = place.read_bytes()
    place.write_bytes(whole[:-100])
    assert copy_of_campaign.materialize(["window_features"], KEY).success
    assert copy_of_campaign.figures("window_features", KEY)["status"] == "made"
    assert place.read_bytes() == whole


def test_one_bad_run_fails_alone_and_is_reported(copy_of_campaign: Laboratory) -> None:
    bag = next(copy_of_campaign.store.run(KEY).bag.glob("*.mcap"))
    bag.write_bytes(bag.read_bytes()[:-1000])
    result = copy_of_campaign.materialize([*PER_RUN, "feature_dataset"], *BOTH)
    assert not result.success
    failure = result.failure_data_for_node("runs")
    assert failure is not None
    assert failure.user_failure_data is not None
    text = failure.user_failure_data.description or ""
    assert "1 of 2 runs failed; the finished ones are kept." in text
    assert f"{KEY}: {copy_of_campaign.store.run(KEY).path} is damaged" in text
    for asset in PER_RUN:
        assert copy_of_campaign.materialized(asset) == set(BOTH) - {KEY}
    assert not copy_of_campaign.instance.get_latest_materialization_event(
        dg.AssetKey("feature_dataset")
    )

    assert copy_of_campaign.materialize(PER_RUN, KEY, config=REFRESH).success
    assert copy_of_campaign.materialized("bags") == set(BOTH)


def test_a_root_that_cannot_be_written_to_fails_before_any_run(empty: Laboratory) -> None:
    empty.root.write_text("a file, not a folder")
    result = empty.materialize(PER_RUN, *BOTH)
    assert not result.success
    assert "ORACLE_HOME" in str(result.failure_data_for_node("runs"))


def test_a_disk_without_room_fails_before_any_run(empty: Laboratory) -> None:
    result = empty.materialize(PER_RUN, *BOTH, budget=StorageBudget(reserve_mb=10**12))
    assert not result.success
    assert "do not fit" in str(result.failure_data_for_node("runs"))
    assert not find_runs(empty.root)


def test_features_of_a_missing_run_record_it_first(empty: Laboratory) -> None:
    assert empty.materialize(["run_features"], KEY).success
    assert empty.store.run(KEY).is_complete()
    assert empty.figures("run_features", KEY)["status"] == "made"
    assert empty.materialized("experiment_runs") == set()
