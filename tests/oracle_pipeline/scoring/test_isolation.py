"""A recording that crashes its process loses only its own verdict."""

import signal
import subprocess
import sys
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.features import build_manager
from oracle_pipeline.features.statistics.reduction import quantile_of
from oracle_pipeline.scoring.isolation import Limits, extract_each, extract_isolated, in_order
from tests.oracle_pipeline.bags.conftest import STRING, text

PLUGIN = """
import os, signal, time
from oracle_pipeline.features import Feature, FeaturePlugin, hookimpl

def compute(window):
    {what}
    return {{"value": 1.0}}

@hookimpl
def register_features():
    return [FeaturePlugin("odd", "odd", (Feature("value", "1", 1.0, "a number"),), compute)]
"""


@pytest.fixture
def bag(tmp_path) -> Path:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/chatter", STRING, [])
        for i in range(20):
            writer.write("/chatter", i * 500_000_000, text("x"))
    return tmp_path / "bag"


def manager_that(what, folder):
    folder.mkdir()
    (folder / "odd.py").write_text(PLUGIN.format(what=what))
    return build_manager(folder)


def test_features_are_computed_in_the_other_process(bag, tmp_path):
    (found,) = extract_isolated(bag, manager_that("pass", tmp_path / "plugins"))
    recording, tables, seen, origin, _ = found
    assert recording == str(bag)
    assert tables.run["odd.value"].tolist() == [1.0]
    assert not origin.has_manifest
    assert set(seen.topics) == {"/chatter"}


@pytest.mark.parametrize(
    ("what", "limits", "reason"),
    [
        ("os._exit(3)", Limits(), "died .exit code 3."),
        ("os.kill(os.getpid(), signal.SIGSEGV)", Limits(), f"died .{signal.SIGSEGV.name}."),
        ("time.sleep(60)", Limits(seconds=3.0), "limit of 3 s; raise it .--time-limit"),
    ],
)
def test_a_process_that_dies_is_an_error_with_its_reason(what, limits, reason, bag, tmp_path):
    with pytest.raises(BagError, match=reason):
        extract_isolated(bag, manager_that(what, tmp_path / "plugins"), limits)


def test_recordings_are_read_at_once_and_come_in_order_with_what_is_wrong(bag, tmp_path):
    program, plain = sys.modules["__main__"], manager_that("pass", tmp_path / "plugins")
    paths = [bag, tmp_path / "none", *[bag] * 8]
    found = list(extract_each(paths, plain))
    assert [path for path, _ in found] == paths
    assert [isinstance(robots, BagError) for _, robots in found] == [False, True] + [False] * 8
    assert sys.modules["__main__"] is program


def test_jobs_run_at_once_and_their_results_come_in_order(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    two = Barrier(2, timeout=60.0)

    def job(number):
        two.wait()
        return number

    assert list(in_order(job, range(20))) == list(range(20))


def test_memory_of_a_process_is_limited(bag, tmp_path):
    manager = manager_that("held = bytearray(8 * 2**30)", tmp_path / "plugins")
    ((_, tables, *_),) = extract_isolated(bag, manager, Limits(gibibytes=2.0))
    assert "MemoryError" in tables.run["missing"].iloc[0]  # the plugin's own; the rest is computed


@pytest.mark.slow
def test_a_process_begins_with_the_machine_code_that_its_recording_needs(bag):
    """Otherwise a suite of many short recordings takes twice as long."""
    quantile_of(np.arange(3.0), 0.5)  # from now on, its machine code is on disk
    code = (
        "import sys; from pathlib import Path; from tests.oracle_pipeline.scoring.test_isolation "
        "import loaded; from oracle_pipeline.scoring.isolation import run_isolated\n"
        f"print(run_isolated(loaded, Path({str(bag)!r})))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=Path(__file__).parents[3], capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert done.stdout == "True\n"


def loaded(_: Path) -> bool:
    return bool(quantile_of.overloads)  # type: ignore[attr-defined]
