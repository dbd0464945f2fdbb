"""Speed of the testbeds: a whole run compared with the yardstick, and where its time goes.

Everything runs on one core. A round is the yardstick, a run and the yardstick again, so that other
load on the machine affects both. Times are processor times, which exclude other programs on the
core.
"""

import functools
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from oracle_pipeline.bags.manifest import Manifest
from oracle_pipeline.bags.run_directory import RunDirectory
from oracle_pipeline.bags.writer import BagWriter
from sim import experiments
from sim.campaigns import Campaign
from sim.experiments import recipe_for
from sim.middleware.endpoints import Subscription
from sim.middleware.executor import Executor, Timer
from sim.middleware.node import Node
from sim.testbeds import TESTBEDS
from sim.turtlebot3 import run as turtlebot3_run
from sim.turtlebot3.world import World
from tools.bench import yardstick
from tools.bench.figures import Row, median, spread

ROUNDS = 5
YARDSTICK_S = 100.0  # of simulated time
_SHOWN = 25  # largest shares that are printed
MODE = "lidar_passthrough_odom"
COLD_START = (
    "from sim.commands.main import main; main()",
    *("record", "-m", MODE, "--goals", "1", "--workers", "1"),
)


def rows() -> Iterator[Row]:
    """Yield the figures."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        warm_up = _record(root, 0)  # compiles the hot loops, unless they are cached
        runs, per_second, yardsticks = [], [], []
        for block in range(ROUNDS):
            before_s = _yardstick_s()
            started = time.process_time()
            runs.append(_record(root, block, refresh=True))
            processor_s = time.process_time() - started
            per_second.append(processor_s / runs[-1].recording_s)
            yardsticks.append((before_s + _yardstick_s()) / 2.0)
        ratios = [run / bare for run, bare in zip(per_second, yardsticks, strict=True)]
        factors = [run.recording_s / run.measured.wall_s for run in runs]
        megabytes = [run.measured.bytes["bag"] / 1e6 / (run.recording_s / 60.0) for run in runs]
        intervals = [run.recording_s / 10.0 for run in runs]
        yield Row("whole run over the yardstick", median(ratios), "x", 4, True, spread(ratios))
        yield _milliseconds("whole run, per simulated second", per_second)
        yield _milliseconds("yardstick, per simulated second", yardsticks)
        yield Row("real-time factor, one core", median(factors), "x", 70, False, spread(factors))
        yield Row("bag, per simulated minute", median(megabytes), "MB", 7, True, spread(megabytes))
        yield Row("intervals of 10 s per run", median(intervals), "", 12, False, spread(intervals))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        yield Row("peak memory", peak, "MiB")
        cold = [_cold_start_s(root / f"cold{i}") for i in range(3)]
        yield Row("new process, one goal, compile cache warm", median(cold), "s", 5, True,
                  spread(cold))  # fmt: skip
        for name, testbed in TESTBEDS.items():
            yield _speed(root, name, testbed.experiments[0])
        yield from _shares(root, warm_up.run)


def _record(root: Path, block: int, *, refresh: bool = False, mode: str = MODE) -> Manifest:
    recipe = recipe_for(mode, block, Campaign())
    return experiments.record_run(recipe, RunDirectory(root, mode, block), refresh=refresh)


def _speed(root: Path, testbed: str, mode: str) -> Row:
    """Return how much faster than real time runs of a testbed are."""
    _record(root, 0, mode=mode)  # compiles
    factors = []
    for block in range(ROUNDS):
        started = time.process_time()
        run = _record(root, block, refresh=True, mode=mode)
        factors.append(run.recording_s / (time.process_time() - started))
    name = f"{testbed}, per second of the processor"
    return Row(name, median(factors), "s", 20, False, spread(factors))


def _yardstick_s() -> float:
    """Return the processor time of the yardstick, per simulated second."""
    return yardstick.run(YARDSTICK_S).processor_s / YARDSTICK_S


def _milliseconds(name: str, seconds: list[float]) -> Row:
    values = [1e3 * value for value in seconds]
    return Row(name, median(values), "ms", remark=spread(values))


def _cold_start_s(out: Path) -> float:
    started = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", *COLD_START, "--out", str(out)], check=True, capture_output=True
    )
    return time.perf_counter() - started


class _Shares:
    """Wall time by the function that spends it, without the functions that it calls."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._running: list[tuple[str, float]] = []

    def call(self, name: str, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Call ``function`` and count its time to ``name``."""
        now = time.perf_counter()
        if self._running:
            caller, since = self._running[-1]
            self.seconds[caller] += now - since
        self._running.append((name, now))
        try:
            return function(*arguments, **named)
        finally:
            now = time.perf_counter()
            name, since = self._running.pop()
            self.seconds[name] += now - since
            if self._running:
                self._running[-1] = (self._running[-1][0], now)


def _shares(root: Path, block: int) -> Iterator[Row]:
    """Yield each node's share of a run's time. Counting makes the run slower."""
    shares = _Shares()

    class Counting(Executor):
        def call_at(self, time_ns: int, callback: Callable[..., None], *arguments: Any) -> None:
            super().call_at(time_ns, shares.call, _owner(callback), callback, *arguments)

        def call_every(self, period_ns: int, callback: Callable[[], None], first_ns: int) -> Timer:
            called = functools.partial(shares.call, _owner(callback), callback)
            return super().call_every(period_ns, called, first_ns)

    patches: list[tuple[Any, str, Any]] = [(turtlebot3_run, "Executor", Counting)]
    for owner, name, method in (
        (World, "physics and rays", "advance_to"),
        (World, "physics and rays", "imu"),
        (World, "physics and rays", "scan"),
        (BagWriter, "bag writer", "write"),
    ):
        function = getattr(owner, method)
        patches.append((owner, method, _method(shares, name, function)))
    kept = [(owner, name, getattr(owner, name)) for owner, name, _ in patches]
    for owner, name, value in patches:
        setattr(owner, name, value)
    try:
        manifest = shares.call("everything else", _record, root, block, refresh=True)
    finally:
        for owner, name, value in kept:
            setattr(owner, name, value)
    total = sum(shares.seconds.values())
    for name, seconds in sorted(shares.seconds.items(), key=lambda share: -share[1])[:_SHOWN]:
        milliseconds = f"({1e3 * seconds / manifest.recording_s:.2f} ms per simulated second)"
        yield Row(f"share of {name}", 100.0 * seconds / total, "%", remark=milliseconds)


def _method(shares: _Shares, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def counted(*arguments: Any, **named: Any) -> Any:
        return shares.call(name, function, *arguments, **named)

    return counted


def _owner(callback: Callable[..., None]) -> str:
    """Return the name of the node that a callback belongs to."""
    if isinstance(callback, functools.partial):
        return _owner(callback.func)
    bound = getattr(callback, "__self__", None)
    if isinstance(bound, Subscription):
        return bound.node
    for holder in (bound, getattr(bound, "node", None), getattr(bound, "_node", None)):
        if isinstance(holder, Node):
            return holder.name
    return type(bound).__name__ if bound is not None else callback.__qualname__
