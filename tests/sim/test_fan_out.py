import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from oracle_pipeline.bags.errors import OracleError
from sim.fan_out import fan_out, process_pool
from sim.worker_pool import LIMIT
from tests.servers import end_with_parent

pytestmark = pytest.mark.slow


def square(x: int) -> int:
    if x == 3:
        raise ValueError("three is not liked")
    if x == 4:
        raise OracleError("Four is out of order; use five.")
    return x * x


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


def test_a_job_that_raises_fails_alone_and_says_why():
    outcomes = {o.job: o for o in fan_out(square, range(6), lambda: ThreadPoolExecutor(2))}
    assert {job: o.result for job, o in outcomes.items() if o.error is None} == {
        0: 0, 1: 1, 2: 4, 5: 25,
    }  # fmt: skip
    assert "ValueError: three is not liked" in outcomes[3].error
    assert outcomes[4].error == "Four is out of order; use five."


def test_jobs_of_a_worker_that_died_are_done_by_another(tmp_path):
    outcomes = list(fan_out(partial(die_once, tmp_path), range(4), lambda: process_pool(2)))
    assert sorted(o.result for o in outcomes) == [0, 1, 2, 3]


def test_a_job_that_kills_workers_is_abandoned_with_an_error():
    outcomes = {o.job: o for o in fan_out(die, range(2), lambda: process_pool(1))}
    assert outcomes[0].result == 0
    assert "worker process died" in outcomes[1].error


def hang(x: int) -> int:
    if x == 1:
        threading.Event().wait()
    return x


def say_where(x: int) -> int:
    if x == 1:
        return lambda: x  # no process can hand this over
    raise UnpicklableError(x, x)


class UnpicklableError(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


def test_a_job_that_hangs_is_ended_and_named_and_the_others_go_on(monkeypatch):
    monkeypatch.setenv(LIMIT, "20")
    outcomes = {o.job: o for o in fan_out(hang, range(4), lambda: process_pool(2))}
    assert {job: o.result for job, o in outcomes.items() if o.error is None} == {0: 0, 2: 2, 3: 3}
    assert outcomes[1].error.startswith("It exceeded the limit of 20 s, so its worker was ended")
    assert LIMIT in outcomes[1].error
    assert not multiprocessing.active_children()


def test_a_job_that_cannot_be_pickled_fails_alone_with_its_reason():
    outcomes = {o.job: o for o in fan_out(say_where, [1, 2], lambda: process_pool(1))}
    assert "pickle" in outcomes[1].error
    assert "UnpicklableError: 2 and 2" in outcomes[2].error


def test_workers_do_many_jobs_each():
    with process_pool(2) as pool:
        found = {pool.submit(os.getpid).result() for _ in range(8)}
    assert os.getpid() not in found
    assert len(found) <= 2


def test_workers_get_the_environment_of_the_moment_in_which_they_start(monkeypatch):
    for value in ("once", "again"):  # what they are forked from has started before
        monkeypatch.setenv("MOMENT", value)
        with process_pool(1) as pool:
            assert pool.submit(os.getenv, "MOMENT").result() == value


def test_workers_start_with_what_the_first_job_needs():
    """All workers after the first one do without imports, which take more than a second."""
    code = (
        "import sys; from sim.fan_out import process_pool\n"
        "from tests.sim.test_fan_out import is_loaded; from sim.experiments import remake_run\n"
        "with process_pool(1) as pool: pool.submit(remake_run, None, None).exception()\n"
        "with process_pool(1) as pool: print(pool.submit(is_loaded, 'sim.experiments').result())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=Path(__file__).parents[2], capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert done.stdout == "True\n"


def test_workers_do_not_import_the_program_that_was_started(tmp_path):
    """A command of Dagster would bring Dagster into each worker."""
    (tmp_path / "of_the_program.py").touch()
    (tmp_path / "program.py").write_text(
        "import of_the_program\nfrom sim.fan_out import process_pool\n"
        "from tests.sim.test_fan_out import is_loaded\n"
        "if __name__ == '__main__':\n"
        "    with process_pool(1) as pool: print(pool.submit(is_loaded, 'of_the_program').result())"
    )
    done = subprocess.run(
        [sys.executable, tmp_path / "program.py"], capture_output=True, text=True, check=True,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
    )  # fmt: skip
    assert done.stdout == "False\n"


def is_loaded(module: str) -> bool:
    return module in sys.modules


@pytest.mark.parametrize("text", ["0", "-1", "soon", "nan"])
def test_a_limit_that_is_no_time_is_refused(monkeypatch, text):
    monkeypatch.setenv(LIMIT, text)
    with pytest.raises(OracleError, match=f"{LIMIT} is '{text}'"):
        process_pool(1)


def test_workers_end_with_their_caller(tmp_path):
    code = (
        "from sim.fan_out import process_pool; from tests.sim.test_fan_out import note_and_hang\n"
        "if __name__ == '__main__': process_pool(1).submit(note_and_hang, "
        f"{str(tmp_path / 'worker')!r}).result()"
    )
    caller = subprocess.Popen(
        [sys.executable, "-c", code], cwd=Path(__file__).parents[2], preexec_fn=end_with_parent()
    )
    worker = tmp_path / "worker"
    while not (worker.exists() and worker.read_text()):
        assert caller.poll() is None
        time.sleep(0.05)
    caller.kill()
    caller.wait()
    for _ in range(6000):
        if not Path(f"/proc/{worker.read_text()}").exists():
            return
        time.sleep(0.05)
    raise AssertionError("the worker outlived its caller")


def note_and_hang(place: str) -> None:
    Path(place).write_text(str(os.getpid()))
    threading.Event().wait()
