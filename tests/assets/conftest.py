"""One short campaign, materialized once: two modes that are a pair, two runs, one goal each."""

import fcntl
import shutil
from collections.abc import Iterator
from multiprocessing import forkserver, set_forkserver_preload
from pathlib import Path

import pytest

from tests.assets.laboratory import (
    EVERYTHING,
    KEYS,
    PER_RUN,
    Laboratory,
    dagster_home,
    with_databases,
)
from tests.instances import instance_of

# Where the work on runs and recordings begins, and what the first one loads: a second of imports
# and half a second of compiled loops that each worker would load again.
FORKED = [
    "assets.worker.run",
    "assets.worker.inspections",
    "oracle_pipeline.replay.picture",
    "oracle_pipeline.scoring.card",
    "oracle_pipeline.scoring.isolation",
    "assets.search.closed_loop",
    "sim.atc.drawing",
    "sim.atc.run",
    "tests.assets.warm",
]


def pytest_collection_finish(session: pytest.Session) -> None:
    """Start what workers are forked from before a test starts it with less to fork."""
    if any("campaign" in getattr(item, "fixturenames", ()) for item in session.items):
        set_forkserver_preload(FORKED)
        forkserver.ensure_running()


@pytest.fixture(scope="session")
def campaign(shared_folder: Path) -> Iterator[Laboratory]:
    """The whole graph over the short campaign; tests read it and change nothing."""
    shared_root = shared_folder / "campaign"
    shared_root.mkdir(exist_ok=True)
    with (shared_root / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with instance_of(with_databases(shared_root / "home")) as instance:
            laboratory = Laboratory(shared_root / "data", instance)
            if not (shared_root / "done").exists():
                assert laboratory.materialize(PER_RUN, KEYS[0], KEYS[1]).success
                assert laboratory.materialize(EVERYTHING, KEYS[2], KEYS[3]).success
                (shared_root / "done").touch()
            fcntl.flock(lock, fcntl.LOCK_UN)
            yield laboratory


@pytest.fixture
def copy_of_campaign(campaign: Laboratory, tmp_path: Path) -> Iterator[Laboratory]:
    """A copy of the files with a separate instance, to change."""
    shutil.copytree(campaign.root, tmp_path / "data")
    with dagster_home(tmp_path / "home") as instance:
        yield Laboratory(tmp_path / "data", instance)


@pytest.fixture
def empty(tmp_path: Path) -> Iterator[Laboratory]:
    with dagster_home(tmp_path / "home") as instance:
        yield Laboratory(tmp_path / "data", instance)
