"""The job that searches a scenario: it reports its findings, and its misses are modes."""

import json
from pathlib import Path

import pytest

from assets.attack_search import TEMPLATES, can_be_varied
from assets.search.search import CONTROLS
from resources.inbox import Inbox
from sim.campaigns import Campaign
from sim.pairs import CONTROL
from sim.scenarios import builtin_scenarios
from tests.assets.laboratory import Laboratory
from tests.recorded_runs import RecordedRuns, linked

OF_SEARCH = Campaign(goals_per_run=1, timeout_s=120.0)  # the job's own limit


def test_templates_are_attacks_on_the_robot_without_actuation() -> None:
    keys = TEMPLATES.get_partition_keys()
    assert {"range_drift", "odometry_reordered", "infrared_ghost"} <= set(keys)
    refused = ["fake_object", "command_scale", "benign_drop", "sensor_freeze", "atc_deadzone"]
    assert not any(can_be_varied(builtin_scenarios()[name]) for name in refused)
    assert not set(refused) & set(keys)


@pytest.mark.slow
def test_a_search_is_reported_and_can_be_continued(
    copy_of_campaign: Laboratory, recorded_run: RecordedRuns, normal_card: Path
) -> None:
    folder = copy_of_campaign.root / "searches" / "range_drift"
    linked(recorded_run(CONTROL, 0, OF_SEARCH), folder / CONTROLS)
    defs = copy_of_campaign.defs(inbox=Inbox(folder="", card=str(normal_card)))
    for budget in (1, 2):
        config = {"budget": str(budget), "blocks": 1, "far": 0.2}
        done = defs.resolve_job_def("search_attacks").execute_in_process(
            partition_key="range_drift",
            instance=copy_of_campaign.instance,
            run_config={"ops": {"search_scenario": {"config": config}}},
        )
        assert done.success
        assert copy_of_campaign.figures("attack_search", "range_drift")["trials"] == budget
    assert len(json.loads((folder / "findings.json").read_text())["findings"]) == 2
    assert (folder / "front.png").is_file()
