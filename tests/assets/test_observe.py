"""The evaluation compares the contract with what `oracle score` sees of a recording."""

from assets.worker.inspections import observe
from oracle_pipeline.scoring.isolation import extracted
from tests.recorded_runs import RecordedRuns


def test_the_interfaces_of_a_run_are_those_that_a_score_compares(
    recorded_run: RecordedRuns,
) -> None:
    run = recorded_run("lidar_passthrough", 0)
    (of_score,) = extracted(run.path)
    assert observe(run) == of_score.observation
    assert of_score.observation.roles
