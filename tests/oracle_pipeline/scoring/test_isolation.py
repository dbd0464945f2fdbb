"""A recording that crashes its process loses only its own verdict."""

import gc
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from oracle_pipeline.bags.errors import BagError
from oracle_pipeline.bags.writer import BagWriter
from oracle_pipeline.features import build_manager
from oracle_pipeline.scoring.isolation import Limits, extract_each, extracted, isolated_each
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


def test_infinite_ranges_give_no_warning_in_this_process_either(recorded_run, recwarn):
    gc.collect()  # what earlier tests left may warn when it is freed
    recwarn.clear()
    extracted(recorded_run("fake_object").path)
    assert not [str(each.message) for each in recwarn]


def test_features_are_computed_in_the_other_process(bag, tmp_path):
    ((_, found),) = extract_each([bag], manager_that("pass", tmp_path / "plugins"))
    ((recording, tables, seen, origin, _),) = found
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
    ((_, error),) = extract_each([bag], manager_that(what, tmp_path / "plugins"), limits)
    assert re.search(reason, str(error))


def test_recordings_are_read_at_once_and_come_in_order_with_what_is_wrong(bag, tmp_path):
    program, plain = sys.modules["__main__"], manager_that("pass", tmp_path / "plugins")
    paths = [bag, tmp_path / "none", *[bag] * 8]
    found = list(extract_each(paths, plain))
    assert [path for path, _ in found] == paths
    assert [isinstance(robots, BagError) for _, robots in found] == [False, True] + [False] * 8
    assert sys.modules["__main__"] is program


def test_jobs_run_at_once_and_their_results_come_in_order(monkeypatch, tmp_path):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    paths = [tmp_path / str(number) for number in range(6)]
    assert list(isolated_each([(meet, path) for path in paths])) == [path.name for path in paths]


def meet(path):
    """Return the name of a path when the other one of its pair exists; later for the first."""
    path.touch()
    other = path.with_name(str(int(path.name) ^ 1))
    while not other.exists():
        time.sleep(0.01)
    time.sleep(0.1 * (int(path.name) % 2 == 0))
    return path.name


def test_a_process_takes_the_next_recording_until_one_fails(monkeypatch, tmp_path):
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    paths = [tmp_path, tmp_path, tmp_path / "none", tmp_path]
    first, second, error, third = isolated_each([(own_number, path) for path in paths])
    assert first == second != third != os.getpid()
    assert "none" in str(error)


def test_a_process_that_dies_after_its_answer_costs_no_other_recording(monkeypatch, tmp_path):
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    numbers = isolated_each([(own_number, tmp_path)] * 3)
    first = next(numbers)
    os.kill(first, signal.SIGKILL)
    while is_running(first):
        time.sleep(0.01)
    second, third = numbers
    assert second == third != first


def is_running(number):
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):  # gone before it was opened, or read
        return False


def own_number(path):
    return path.stat() and os.getpid()


@pytest.mark.parametrize("threads", [False, True], ids=["a fork of this", "a fork of a server"])
def test_a_process_is_a_fork_of_one_without_other_threads(threads, tmp_path):
    """A fork of a process with threads might wait indefinitely for a lock of one of them."""
    code = (
        "import os, threading; from pathlib import Path; "
        "from tests.oracle_pipeline.scoring.test_isolation import parent; "
        "from oracle_pipeline.scoring.isolation import run_isolated\n"
        f"other = threading.Thread(target=threading.Event().wait, daemon=True)\n"
        f"{threads} and other.start()\n"
        "print(run_isolated(parent, Path()) == os.getpid())"
    )
    assert printed(code) == f"{not threads}\n"


def parent(_: Path) -> int:
    return os.getppid()


def test_memory_that_a_process_takes_over_does_not_count():
    code = (
        "from pathlib import Path; from tests.oracle_pipeline.scoring.test_isolation import parent;"
        "from oracle_pipeline.scoring.isolation import Limits, run_isolated\n"
        "held = bytearray(600 * 2**20)\n"
        "print(run_isolated(parent, Path(), Limits(gibibytes=0.25)) > 0, len(held))"
    )
    assert printed(code) == f"True {600 * 2**20}\n"


def test_memory_of_a_process_is_limited(bag, tmp_path):
    manager = manager_that("held = bytearray(8 * 2**30)", tmp_path / "plugins")
    ((_, ((_, tables, *_),)),) = extract_each([bag], manager, Limits(gibibytes=2.0))
    assert "MemoryError" in tables.run["missing"].iloc[0]  # the plugin's own; the rest is computed


def printed(code: str) -> str:
    """Return what a program prints that knows the tests."""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=Path(__file__).parents[3], capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return done.stdout
