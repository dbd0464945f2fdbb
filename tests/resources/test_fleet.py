"""The fleet: every job has an outcome, and a job that fails fails alone."""

import math
import os

import dagster as dg
import pytest

from oracle_pipeline.definitions import build_defs
from resources.fleet import Fleet

pytestmark = pytest.mark.slow


def test_every_job_has_an_outcome_and_a_failure_its_reason() -> None:
    outcomes = {o.job: o for o in Fleet(workers=2).outcomes(math.sqrt, [4.0, -1.0, 9.0])}
    assert {job: o.result for job, o in outcomes.items()} == {4.0: 2.0, -1.0: None, 9.0: 3.0}
    assert "ValueError" in str(outcomes[-1.0].error)


def test_nothing_to_do_starts_nothing() -> None:
    assert list(Fleet().outcomes(math.sqrt, [])) == []


def test_by_default_every_processor_is_used() -> None:
    assert Fleet().workers == os.cpu_count()


def test_a_fleet_without_workers_is_an_error() -> None:
    with pytest.raises(ValueError, match="workers"):
        Fleet(workers=0)


def test_the_workers_of_a_dagster_run_stay_for_all_its_steps() -> None:
    with dg.build_resources({"fleet": Fleet(workers=1)}) as there:
        of_steps = [next(there.fleet.outcomes(process_id, [step])).result for step in (1, 2)]
        (error,) = [outcome.error for outcome in there.fleet.outcomes(math.sqrt, [-1.0])]
        assert "ValueError" in str(error)
    assert of_steps[0] == of_steps[1] != os.getpid()
    with pytest.raises(ProcessLookupError):
        os.kill(of_steps[0], 0)


def process_id(_: int) -> int:
    return os.getpid()


def test_a_cluster_is_a_matter_of_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORACLE_DASK", "tcp://scheduler:8786")
    monkeypatch.setenv("ORACLE_HOME", "s3://bucket/campaign")
    resources = build_defs().resources
    assert resources is not None
    with dg.build_resources({name: resources[name] for name in ("fleet", "store")}) as there:
        assert there.fleet.address == "tcp://scheduler:8786"
        assert (there.store.root, there.store.is_local) == ("s3://bucket/campaign", False)
