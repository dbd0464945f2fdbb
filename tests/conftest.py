"""Settings that every test runs under, and what all of them share."""

import fcntl
import gc
import os
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Before NumPy is imported: as many test processes as cores, each with one thread.
os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

import pytest
from hypothesis import settings

# Or each of a hundred processes compiles all that it imports, which takes twice as long.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Tests leave little garbage in cycles: it is searched for a hundred times less often.
gc.set_threshold(70_000)

# The same examples everywhere, and no deadline: a busy machine is not a wrong answer.
settings.register_profile("repeatable", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("repeatable")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put files that take long first, so that no process is left alone with one at the end.

    With ``--dist loadfile`` a file is the unit of work. ``slow(8)`` says that a test takes about
    8 s; without a number it counts as one.
    """
    seconds: Counter[Path] = Counter()
    for item in items:
        if slow := item.get_closest_marker("slow"):
            seconds[item.path] += slow.args[0] if slow.args else 1
    items.sort(key=lambda item: -seconds[item.path])
    gc.freeze()  # what is imported stays, and is searched no more


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """A folder that all test processes share; writers take a lock."""
    base = tmp_path_factory.getbasetemp()
    return base if worker_id == "master" else base.parent


@pytest.fixture(scope="session")
def recorded_run(shared_folder: Path):
    """Real runs, each recorded once: see ``RecordedRuns``."""
    from tests.recorded_runs import RecordedRuns  # imports the simulator, which most do without

    folder = shared_folder / "recorded_runs"
    folder.mkdir(exist_ok=True)
    return RecordedRuns(folder)


@contextmanager
def locked(place: Path) -> Iterator[None]:
    """Let one test process at a time make something."""
    with Path(f"{place}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture(scope="session")
def normal_card(shared_folder: Path, recorded_run) -> Path:
    """A reference card of five normal runs of one goal, learned once for all test processes."""
    from oracle_pipeline.features import build_manager
    from oracle_pipeline.scoring.learning import learn
    from oracle_pipeline.scoring.reference import read_reference

    card = shared_folder / "normal.card"
    with locked(card):
        if not card.exists():
            runs = [recorded_run("lidar_passthrough", number).path for number in range(5)]
            learn(read_reference(runs, build_manager())).save(card)
    return card


@pytest.fixture(scope="session")
def report_pages(shared_folder: Path) -> Path:
    """Pages of synthetic campaigns, made once for all test processes: see ``write_pages``."""
    from tests.oracle_pipeline.reporting.pages import write_pages

    folder = shared_folder / "report_pages"
    with locked(folder):
        if not folder.exists():
            write_pages(folder)
    return folder
