"""The fleet on a Dask cluster of separate processes: the same laws hold as on this machine."""

import math
import os
import signal
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import dagster as dg
import pytest

from resources import cluster
from resources.fleet import Fleet
from tests.servers import dask_cluster

pytestmark = pytest.mark.slow


def die_once(folder: Path, x: int) -> int:
    """Job 1 kills its worker, the first time it runs."""
    mark = folder / "died"
    if x == 1 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def die(x: int) -> int:
    if x == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def rest(x: int) -> int:
    time.sleep(1.0)
    return x


def hang_once(folder: Path, x: int) -> int:
    if x == 1 and not (folder / "hung").exists():
        (folder / "hung").touch()
        time.sleep(600.0)
    return x


def note(place: Path) -> None:
    with place.open("a") as notes:
        notes.write("done\n")


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with dask_cluster(tmp_path_factory.mktemp("dask"), workers=2) as address:
        yield Fleet(address=address)


def test_every_job_has_an_outcome_and_a_failure_its_reason(fleet: Fleet) -> None:
    outcomes = {o.job: o for o in fleet.outcomes(math.sqrt, [4.0, -1.0, 9.0])}
    assert {job: o.result for job, o in outcomes.items()} == {4.0: 2.0, -1.0: None, 9.0: 3.0}
    assert "ValueError" in str(outcomes[-1.0].error)


def test_equal_jobs_are_each_done(fleet: Fleet, tmp_path: Path) -> None:
    place = tmp_path / "done"
    list(fleet.outcomes(note, [place, place]))
    assert place.read_text() == "done\ndone\n"


def test_jobs_of_a_worker_that_died_are_done_by_another(fleet: Fleet, tmp_path: Path) -> None:
    outcomes = list(fleet.outcomes(partial(die_once, tmp_path), range(6)))
    assert (tmp_path / "died").exists()
    assert sorted(o.result or 0 for o in outcomes) == list(range(6))


def test_a_job_that_kills_workers_is_abandoned_with_an_error(fleet: Fleet) -> None:
    outcomes = {o.job: o for o in fleet.outcomes(die, range(3))}
    assert {job: o.result for job, o in outcomes.items()} == {0: 0, 1: None, 2: 2}
    assert "worker process died" in str(outcomes[1].error)


def test_a_job_that_hangs_ends_its_worker_and_the_log_names_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ORACLE_JOB_TIMEOUT", "2")
    with dask_cluster(tmp_path, workers=1) as address:
        outcomes = {o.job: o for o in Fleet(address=address).outcomes(
            partial(hang_once, tmp_path), range(4))}  # fmt: skip
    assert {job: o.result for job, o in outcomes.items()} == {0: 0, 1: None, 2: 2, 3: 3}
    assert "limit of 2 s" in str(outcomes[1].error)
    assert "ORACLE_JOB_TIMEOUT" in str(outcomes[1].error)
    log = (tmp_path / "workers.log").read_text(encoding="utf-8")
    assert "Begin: 1" in log
    assert "limit of 2 s: 1" in log


def test_jobs_of_a_lost_scheduler_are_done_once_it_is_started_again(tmp_path: Path) -> None:
    with dask_cluster(tmp_path / "first", workers=1) as address:
        outcomes = Fleet(address=address).outcomes(rest, range(4))
        done = [next(outcomes)]
    with dask_cluster(tmp_path / "second", workers=1, port=address.rpartition(":")[2]):
        done += outcomes
    assert sorted(o.result or 0 for o in done) == list(range(4)), done


def test_the_error_for_an_unreachable_cluster_states_a_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_S", 0.5)
    with pytest.raises(dg.Failure, match="127.0.0.1:9.*ORACLE_DASK"):
        list(Fleet(address="tcp://127.0.0.1:9").outcomes(math.sqrt, [1.0]))


def test_the_error_for_a_cluster_without_workers_states_a_remedy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_S", 2)
    with (
        dask_cluster(tmp_path, workers=0) as address,
        pytest.raises(dg.Failure, match="has no workers.*dask worker"),
    ):
        list(Fleet(address=address).outcomes(math.sqrt, [1.0]))
