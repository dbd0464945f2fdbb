import os
import signal
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from oracle_pipeline.bags.errors import OracleError
from sim.fan_out import fan_out, process_pool


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


def test_a_job_that_keeps_killing_its_worker_is_given_up_and_named():
    outcomes = {o.job: o for o in fan_out(die, range(2), lambda: process_pool(1))}
    assert outcomes[0].result == 0
    assert "worker process died" in outcomes[1].error
